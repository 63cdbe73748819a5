"""`camber gnss inspect` and `camber gnss solve`: recordings of raw observations."""
