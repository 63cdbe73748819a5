"""Tools around the services: replay, record, evaluate, report."""
