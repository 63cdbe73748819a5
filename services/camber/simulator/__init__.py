"""Inputs as a real vehicle gives them: from recordings, from their truth, and from a simulated drive."""
