"""The batched environment: many worlds of a scenario, stepped together, and what it stands on.

Read vector_env first; then spaces, agents (who is alive, on which side), lifecycle (where episodes begin and end),
validation (of arguments), buffers, concurrency (`send` and `recv`), wrappers (Gymnasium's that cannot work), make.
"""
