"""Driving an encounter while one watches: nothing is rated here."""
