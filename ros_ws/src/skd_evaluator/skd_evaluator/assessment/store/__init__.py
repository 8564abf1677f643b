"""Results on disk: written, read back, verified."""
