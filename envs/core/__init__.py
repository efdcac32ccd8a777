"""The batched environment, in which many worlds of a scenario are stepped together, and its parts.

Read vector_env first; then spaces, agents (living agents and sides), lifecycle (beginning and end of episodes),
validation (of arguments), concurrency (`send` and `recv`).
"""
