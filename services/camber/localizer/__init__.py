"""Localizer: sweeps, motion and map become an approximate pose, without the satellites under test."""
