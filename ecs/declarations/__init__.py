"""Declarations of mechanics: components, events, fields, access, systems, phases, numbers, archetypes, roles.

A declaration is checked by itself when it is created, and does not refer to a batch of worlds.
"""
