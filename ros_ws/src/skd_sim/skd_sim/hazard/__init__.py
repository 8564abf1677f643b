"""The hazard network: what is a hazard, how scans become its input, the network, and how it is trained."""
