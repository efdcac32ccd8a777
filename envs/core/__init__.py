"""The batched environment, in which many worlds of a scenario are stepped together, and its parts.

Read vector_env first; then spaces (and living agents, sides, statistics), observations, lifecycle (beginning and end of
episodes), one_world (queries, entities put by hand), validation (of arguments), concurrency (`send` and `recv`).
"""
