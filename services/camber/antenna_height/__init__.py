"""How high the antenna stands above the road: H (1) to (7)."""
