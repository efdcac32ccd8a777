"""The state of a batch of worlds: places and first values of columns, and numbers that differ.

A `MemoryLayout` is computed from modules; `numbers` finds and places the numbers that differ between worlds or between
agents; `episode` sets them when an episode begins; `tables` has the memory itself. Systems do not run here.
"""
