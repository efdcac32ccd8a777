"""Snapshots of worlds as plain arrays: made, validated, restored, saved."""
