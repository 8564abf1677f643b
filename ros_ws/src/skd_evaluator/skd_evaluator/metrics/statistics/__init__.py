"""Means, rates, intervals and sizes of samples."""
