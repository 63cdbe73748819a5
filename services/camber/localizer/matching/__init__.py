"""Layered scan matching: sweep preparation, local map, ground alignment, registration, covariance."""
