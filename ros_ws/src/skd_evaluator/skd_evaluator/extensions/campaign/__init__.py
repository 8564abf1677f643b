"""Campaigns of many assessments: described in one file, stored episode by episode, and resumed whatever ended them."""
