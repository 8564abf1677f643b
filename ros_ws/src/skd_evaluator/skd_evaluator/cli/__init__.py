"""The command line `skd`."""
