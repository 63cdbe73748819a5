"""Faults of a simulated drive: their schedule, of the radio, of the vehicle."""
