"""Receivers and their files → tentative positions of the antenna."""
