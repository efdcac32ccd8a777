"""Training the paper's policies: networks, PPO for many agents, runs with logs and checkpoints.

Needs PyTorch (`pip install 'outlast[train]'`); nothing outside of this package imports it.
"""
