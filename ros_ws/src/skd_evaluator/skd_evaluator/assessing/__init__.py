"""From what is asked for to an assessment on disk, alike for the command line, campaigns and the graph's evaluator."""
