"""Training the paper's policies: networks, PPO for many agents, runs with logs and checkpoints.

Needs PyTorch (`pip install 'outlast[train]'`); no other package of outlast imports it.
"""
