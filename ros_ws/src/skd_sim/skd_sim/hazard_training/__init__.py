"""Training of the hazard network: a tool, which no episode uses."""
