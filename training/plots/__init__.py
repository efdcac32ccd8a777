"""Comparing runs: curves of several settings in one figure, and a table of end values. Does not need PyTorch."""
