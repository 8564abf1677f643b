"""Campaigns of many assessments, described in one file, stored episode by episode, resumed after anything."""
