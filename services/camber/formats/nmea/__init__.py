"""NMEA 0183 sentences, decoded and encoded."""
