"""Distances of a pair (φ, ψ)."""
