"""A replay through the real processes in lock step over the bus: barrier, feeder, processes."""
