"""Many results at a glance: what is under a folder, and how a car has changed."""
