"""The margin of any other car, found by asking it."""
