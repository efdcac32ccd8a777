"""The batched environment: many worlds of a scenario, stepped together, and its parts.

Read vector_env first; then spaces, agents (who is alive, on which side), lifecycle (where episodes begin and end),
validation (of arguments), buffers, concurrency (`send` and `recv`), wrappers (which of Gymnasium's cannot work), make.
"""
