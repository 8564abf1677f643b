"""The estimate of a figure of the physical car from pairs and from every simulated figure, and what is known of it."""
