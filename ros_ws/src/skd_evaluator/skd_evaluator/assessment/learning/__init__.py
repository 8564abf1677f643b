"""Learning a car before it is rated."""
