"""Parts of training that do not need PyTorch: files, tables, statistics, curves and the settings of a run."""
