"""The processes of a graph, their logs and domains."""
