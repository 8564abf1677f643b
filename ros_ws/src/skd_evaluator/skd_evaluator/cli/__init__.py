"""The command line `skd`."""

from skd_evaluator.cli.main import main

__all__ = ["main"]
