"""The margin: the least deviation with which the moving car could have hit."""
