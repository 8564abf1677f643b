"""A user's controller in a process of its own, which holds nothing of the test but what a car knows.

Nothing is imported here: that process closes its view of other processes before it loads anything.
"""
