"""Fusion of the fleet's votes into heights of road surfaces."""
