"""Whether an episode can have happened, recomputed from its states: of recordings, and of other simulators."""
