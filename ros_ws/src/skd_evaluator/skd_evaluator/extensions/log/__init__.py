"""Conflicts in the recordings of a drive, driven again and ranked by safety margin."""
