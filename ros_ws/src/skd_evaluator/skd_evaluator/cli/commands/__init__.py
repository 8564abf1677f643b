"""One module for each command of `skd`, under its name."""
