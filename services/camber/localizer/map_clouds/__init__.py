"""Point clouds of the map around the vehicle: download, blocks, normals, static structure."""
