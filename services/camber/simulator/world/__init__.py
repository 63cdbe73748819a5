"""A district with its streets and buildings, rays through it, and the map that a survey makes of it."""
