"""Scenarios as data: a game's mechanics with their numbers, the paper's variants, and ablations of their flaws."""
