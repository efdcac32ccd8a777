"""Compilation of a layout and systems into machine code: their order, their arguments, the tick, and its cache.

Each system is compiled by itself, and its code is shared by every scenario that has it; `cache_key` lists its
dependencies.
"""
