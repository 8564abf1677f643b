"""Who waits for whom in the node graph, and what a command can mean."""
