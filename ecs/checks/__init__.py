"""Checks that a user's system does what it declares, by running it and by reading it; and the hash of a game's code.

`trial` takes one world through a few ticks as Python when worlds are made for the first time. Users' systems are
`traced` in these: they run on stand-ins for tables, rows and random draws, which refuse what is not declared.
`source_check` reads the branches that were not taken. `code_hash` tells games apart, also those that were tried.
"""
