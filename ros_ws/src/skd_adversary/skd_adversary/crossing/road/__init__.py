"""The road that the predicted car follows: path coordinates, contact."""
