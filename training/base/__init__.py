"""Parts of training that need no PyTorch: files, tables, statistics, curves, and what a run is asked for."""
