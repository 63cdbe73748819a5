"""Files of a simulated drive or fleet."""
