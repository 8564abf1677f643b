"""The car under test: the protocol that a user's controller fulfils, and the cars that come with SKD."""
