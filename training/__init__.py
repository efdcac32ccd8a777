"""Training of agents: PPO, opponents, evaluation, the benchmark, and the paper's experiments.

Each part imports only those above it in this list, so they can be read in this order:

========= =============================================================================================
base      what all share without PyTorch: files, tables, statistics, curves, what a run is asked for
plots     runs in groups, their curves in figures, and tables of their end values; without PyTorch, too
policies  observations as tensors, networks, saved policies, and players that act by them
arena     policies against each other: opponents, matches, ratings, and evaluations
ppo       rollouts of many worlds, the loss, updates; on one or several processes
runs      training with logs, checkpoints and films in a folder; several runs beside each other
benchmark tasks, protocol, and verification of results
research  the authors' curves, claims about them, and the paper's experiments, trained and compared
cli       the commands
========= =============================================================================================

No other package of outlast imports PyTorch (`pip install 'outlast[train]'`). Here, base, plots, research and cli can be
imported without it, as far as nothing plays.
"""
