"""Faces: scenarios as data, the batched environment, policies, rollouts, the command line."""
