"""The margin: the least deformation with which anybody could have been hit by the moving car."""
