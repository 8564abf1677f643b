"""The world, and what a simulator is."""
