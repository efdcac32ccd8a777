"""Anchors: for each task TASK.json with ratings of all of the suite, and frozen checkpoints. `make` makes both."""
