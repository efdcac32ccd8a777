"""Plane geometry that several mechanics share; your own mechanics may import it.

blocks: the rows of a bitset, sixteen at a time. aabb: which rows a ray or a circle may meet. rays, points: exact tests
of one row. broad_phase: distances between bodies, and how far they may move. bounds: ends of positions in observations.
"""
