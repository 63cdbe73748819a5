"""Figures of merit: truth, baselines, statistics, reports, the Monte Carlo lab, the evidence page."""
