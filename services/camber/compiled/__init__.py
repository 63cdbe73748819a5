"""Compilation by numba: the decorator of this project and the cache of machine code on disk."""
