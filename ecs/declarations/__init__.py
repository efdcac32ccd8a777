"""Declarations of mechanics: components, events, fields, access, systems, phases, numbers, archetypes, roles.

A declaration is checked when it is made, by itself, and refers to no batch of worlds.
"""
