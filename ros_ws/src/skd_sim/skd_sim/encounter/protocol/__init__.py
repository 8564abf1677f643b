"""Tests of regulators: what their target does, and files of encounters that build upon others."""
