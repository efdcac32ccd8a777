"""The batched environment, in which many worlds of a scenario are stepped together, and its parts.

Read vector_env first; then spaces, agents (who is alive, on which side), lifecycle (where episodes begin and end),
validation (of arguments), concurrency (`send` and `recv`).
"""
