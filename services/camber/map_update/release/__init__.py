"""Releases of the map from the fusion's results, and changes that wait for review."""
