"""How a program begins and ends: signals, requirements, bounds."""
