"""Runs: training with logs, checkpoints and films in a folder, and runs beside each other."""
