"""Velocity from Doppler and the heading that follows from it."""
