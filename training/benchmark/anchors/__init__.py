"""Anchors: for each task, TASK.json with ratings of the whole suite, and frozen checkpoints. `make` makes both."""
