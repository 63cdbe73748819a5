"""How a vehicle moves along a path, and what its sensors say."""
