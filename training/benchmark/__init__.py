"""The benchmark: tasks that never change meaning, one protocol of training and tests, and its tables.

Read in this order: tasks, agents, suite, matches, entry (`outlast benchmark run` for an agent and a seed),
result (the file that it writes), verify, crossplay and scores, table. docs/evaluating.md describes the protocol.
"""
