"""Policies: observations as tensors, networks, files of weights, and players that act by them."""
