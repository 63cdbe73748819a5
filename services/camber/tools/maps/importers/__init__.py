"""`camber map build`: releases of the map from the formats that people have."""
