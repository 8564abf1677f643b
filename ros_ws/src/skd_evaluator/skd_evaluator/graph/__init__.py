"""Running the node graph from the command line: its processes, its domain, and a runner over it."""
