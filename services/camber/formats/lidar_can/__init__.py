"""Packets of LiDAR sensors, network captures, CAN logs and DBC files."""
