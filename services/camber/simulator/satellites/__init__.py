"""Satellites, their signals between the buildings, and what a receiver makes of them."""
