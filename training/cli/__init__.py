"""Commands that this package adds to the command line, a file each: they load PyTorch only when they run."""
