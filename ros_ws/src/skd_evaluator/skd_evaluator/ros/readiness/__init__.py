"""Whether all of a graph is there, waits, and is itself."""
