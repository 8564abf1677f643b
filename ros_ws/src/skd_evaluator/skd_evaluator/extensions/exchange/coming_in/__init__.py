"""Tracks of others, and what SKD itself has exported, as safe trajectories."""
