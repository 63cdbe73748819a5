"""Shared mathematics of positions: ellipsoid, local frames, rigid motions, covariances and GPS time."""
