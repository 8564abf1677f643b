"""How the adversary predicts the car."""
