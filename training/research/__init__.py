"""Checks of the paper's claims against our runs: learning curves, end values, figures and kept results.

The CSV files are the paper's own training curves, one file for each variant, from one run each. Source: TensorBoard
event files of the runs behind the figures of Fanti (2022). A point is a rollout of 16384 environment steps; its value
is the mean over the episodes that ended in it, with sampled actions. Returns and kills belong to an agent, or to a
team; heals and boxes to all agents.
"""
