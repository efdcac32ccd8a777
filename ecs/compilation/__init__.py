"""From a layout and systems to machine code: their order, their arguments, the tick, and the cache that keeps it.

Each system is compiled by itself, and its code is kept for every scenario that has it; `cache_key` says what it
depends on.
"""
