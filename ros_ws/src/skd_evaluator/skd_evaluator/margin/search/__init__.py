"""The search for the safety margin of a car that is not known beforehand."""
