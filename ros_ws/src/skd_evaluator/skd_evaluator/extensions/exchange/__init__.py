"""Episodes in formats of others, both ways: OpenSCENARIO, OSI, CommonRoad, csv; and tracks of others as φ."""
