"""The benchmark: tasks that never change meaning, one protocol of training and tests, and its tables.

Read in this order: tasks, agents, suite, manifest (the plan), games (a match, and how it is verified), entry (`outlast
benchmark run` for an agent and a seed), result (the file that it writes), verify, scores, table, archive, people.
docs/benchmark.md describes the protocol.
"""
