"""Planners and tools for problems of any kind, which no crossing uses."""
