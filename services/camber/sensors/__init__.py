"""LiDARs and CAN buses of a vehicle → sweeps and motion."""
