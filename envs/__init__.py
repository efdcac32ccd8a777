"""Environments: worlds that people play, learners train in and commands run.

Read in this order: scenarios (which game), core (many worlds of it, stepped together), rollout (policies that play),
rendering (pictures). Then adapters (the same worlds for other libraries), snapshots (saved and restored states),
recording (runs that replay bit for bit), datasets, web (replays and play in the browser), storage (files), api (what
`outlast` itself has), cli (the command line).
"""
