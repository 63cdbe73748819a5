"""Map tile server: road elevation, links and tiles from a release of the map."""
