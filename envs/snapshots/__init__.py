"""Snapshots of worlds as plain arrays: making, validating, restoring and saving them."""
