"""What all of training shares without PyTorch: files, tables, statistics, curves, and what a run is asked for."""
