"""Health of a service: issues, report, metrics and the probe that asks for it."""
