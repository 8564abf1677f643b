"""Running episodes: one, many, in workers, on a cluster."""
