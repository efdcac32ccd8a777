"""The front door: what `outlast` has to make, play, film and check games."""
