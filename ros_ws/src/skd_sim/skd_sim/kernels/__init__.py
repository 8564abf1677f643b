"""Compiled functions, and the cache of their code."""
