"""`camber lab`: Monte Carlo simulation of wrong fixes, faults and right fixes."""
