"""Everything the others found → one verdict per fix, a position with its bounds, uploads for the fleet."""
