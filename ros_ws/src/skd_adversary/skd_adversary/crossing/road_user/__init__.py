"""How the adversary can move."""
