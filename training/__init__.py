"""Training of agents: PPO, opponents, evaluation, the benchmark, and the paper's experiments.

Each part imports only those above it in this list, so they can be read in this order:

============ ==========================================================================================
base         what all share without PyTorch: files, tables, statistics, curves, what a run is asked for
policies     observations as tensors, networks, saved policies, and players that act by them
ppo          rollouts of many worlds, the loss, updates, opponents; on one or several processes
runs         training with logs, checkpoints and films in a folder; several runs beside each other
paper        the authors' curves, and claims about them
plots        curves of runs in one figure
evaluation   matches between policies, and ratings
benchmark    tasks, protocol, and verification of results
reproduction the paper's experiments and their corrected games, trained and compared
cli          the commands
============ ==========================================================================================

No other package of outlast imports PyTorch (`pip install 'outlast[train]'`). Here, all but policies, ppo and runs can
be imported without it, as far as nothing plays.
"""
