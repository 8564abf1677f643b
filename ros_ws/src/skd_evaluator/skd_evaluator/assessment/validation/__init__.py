"""Whether an episode can have happened: of recordings, and of other simulators."""
