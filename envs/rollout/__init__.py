"""Rollouts: policies play episodes in many worlds, here or on a Ray cluster, and summaries are made of them."""
