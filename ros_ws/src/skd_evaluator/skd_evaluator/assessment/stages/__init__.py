"""From options to an assessment on disk, in the same way for the command line, campaigns and the graph's evaluator."""
