"""Few physical trials and many simulated ones: what the physical car does, with an interval that both make narrower."""
