"""Comparing runs: curves of several settings in one figure, and a table of their end values. Needs no PyTorch."""
