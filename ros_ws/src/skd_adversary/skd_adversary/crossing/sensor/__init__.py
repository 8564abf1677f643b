"""What the adversary sees of the car."""
