"""Maps and point clouds of other programs: Lanelet2, OpenDRIVE, LAS, PCD, PLY, Argoverse 2; their datums."""
