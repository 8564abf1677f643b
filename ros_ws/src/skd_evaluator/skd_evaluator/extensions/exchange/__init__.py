"""Import of recorded tracks as φ, and export of episodes: OpenSCENARIO, OpenDRIVE, OSI, CommonRoad, csv."""
