"""Safe trajectories φ from files: plain csv, and the recordings of the CITR dataset."""
