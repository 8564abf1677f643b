"""Driving a scenario while one watches: nothing is rated here."""
