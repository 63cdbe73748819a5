"""Candidate fixes: of the engine, of a receiver, and from other satellite subsets."""
