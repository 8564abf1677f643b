"""What exported files call those who are in them; by the same names they are found again when a file is imported."""

from __future__ import annotations

EGO, ADVERSARY = "Ego", "Adversary"
OTHER, OBSTACLE = "Other_{}", "Obstacle_{}"
ROAD_FILE = "road.xodr"
EXPORT, IMPORT = "export.json", "import.json"
SOURCE = "skd.role"
"""Type of OSI's external references that say whom an object is."""
EGO_ID, ADVERSARY_ID, FIRST_OTHER_ID = 1, 2, 3
"""Ids of OSI and CommonRoad; the others follow in the scenario's order, then the obstacles."""
