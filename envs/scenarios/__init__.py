"""Scenarios as data: the mechanics of a game with their numbers, the paper's variants, and ablations of their flaws."""
