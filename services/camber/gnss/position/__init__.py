"""Positions from code and phase: single point, float solution and the RTK engine."""
