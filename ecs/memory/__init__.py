"""The state of a batch of worlds: where columns lie, what they begin with, and numbers that differ.

A `MemoryLayout` is computed from modules; `numbers` says which numbers differ from world to world and from agent to
agent, and where they lie; `episode` sets them when an episode begins; `tables` has the memory itself. No system runs
here.
"""
