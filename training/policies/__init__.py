"""Policies: observations as tensors, networks, the files they are saved in, and players that act by them."""
