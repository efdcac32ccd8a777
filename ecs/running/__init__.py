"""A running batch of worlds: the shared parts of all batches of a game, ticks, threads, and tables for callers."""
