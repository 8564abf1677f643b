"""The report: one HTML file that holds all of it, and asks nobody for anything."""
