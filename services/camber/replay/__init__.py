"""Recorded drives: their inputs, the barrier's feeder, surrogates, and replay in one process or over the bus."""
