"""A batch of worlds as it runs: what all batches of a game share, ticks, threads, and the tables that callers see."""
