"""The batched environment: many worlds of a scenario, stepped together, and what it stands on.

Read vector_env first; then spaces, lifecycle (which worlds have started and ended), validation (of arguments),
buffers, concurrency (`send` and `recv`), make.
"""
