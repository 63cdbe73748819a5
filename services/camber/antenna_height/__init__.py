"""Antenna height above the road, JP7707657B2 eq. (1) to (7): four methods, compared with one another."""
