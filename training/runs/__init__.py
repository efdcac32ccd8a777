"""Runs: training with logs, checkpoints and films in a folder, and several runs at the same time."""
