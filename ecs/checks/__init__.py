"""Checks of users' systems against their declarations, by running and by reading them; and the hash of a game's code.

`trial` runs one world through a few ticks as Python when worlds are made for the first time. In these, users' systems
are `traced`: they run on stand-ins for tables, rows and random draws, which raise errors for undeclared use.
`source_check` reads the branches that were not taken. `code_hash` identifies games, also those that were tried.
"""
