"""The state of a batch of worlds: where columns lie, what they begin with, and numbers that differ.

A `Layout` is computed from modules; `varied` has the numbers that differ from world to world, `per_agent` those that
differ from agent to agent; `tables` has the memory itself. No system runs here.
"""
