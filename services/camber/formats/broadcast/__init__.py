"""Bit fields of broadcast navigation messages (LNAV, I/NAV, D1, D2) and of the ephemerides in them."""
