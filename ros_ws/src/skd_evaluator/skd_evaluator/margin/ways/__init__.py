"""What the adversary of the margin can do."""
