"""The stages of an assessment, from safe trajectories to checks."""
