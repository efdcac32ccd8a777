"""Environments: worlds for people, learners and the command line.

Read in this order: scenarios (which game), core (many worlds of it, stepped together), rollout (policies that play),
rendering (pictures). Then adapters (the same worlds for other libraries), snapshots (state, saved and restored),
recording (runs that are repeated to the bit), datasets, inspect and web (replays and play in the browser), storage
(files), cli (the command line).
"""
