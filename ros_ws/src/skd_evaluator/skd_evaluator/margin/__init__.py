"""The margin: the least deviation with which anybody could have been hit by the moving car."""
