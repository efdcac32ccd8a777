"""The benchmark: tasks that never change meaning, agents that are trained and tested by one protocol, and its tables.

Read in this order: tasks, agents, suite, matches, entry (what `outlast benchmark run` does for an agent and a seed),
result (the file that it writes), verify, crossplay and scores, table. docs/evaluating.md describes the protocol.
"""
