"""Learning the predictive model of a car from logs: a law by maximum likelihood, or a forest where none fits."""
