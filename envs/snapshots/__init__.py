"""The state of worlds as plain arrays: taken, checked, put back, saved."""
