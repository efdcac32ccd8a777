"""Plane geometry that several mechanics share; your own mechanics may import it.

blocks: the rows of a bitset, sixteen at a time. aabb: rows that a ray or a circle may meet. rays, points: exact tests
of one row. broad_phase: distances between bodies, and safe motions. bounds: ends of observed positions.
"""
