"""NMEA 0183 sentences, read and written."""
