"""The benchmark: tasks that never change meaning, one protocol of training and tests, and its tables.

Read in this order: tasks, suite, manifest (the plan), games (a match, and how it is verified), entry (an agent and a
seed), result (the files), verify (also archives), scores, table, people. docs/benchmark.md describes the protocol.
"""
