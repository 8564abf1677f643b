"""Nodes of one process: what they say to each other goes by a call, and is published for others."""
