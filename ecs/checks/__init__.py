"""Checks, on its code, that a system does what it declares; and the hash of code that tells games apart.

Only systems that are not the package's own are checked, when worlds are made for the first time.
"""
