"""What reports show of the risk: the most likely failures, and margin against risk."""
