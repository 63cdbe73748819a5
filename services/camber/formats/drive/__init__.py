"""Files of a recorded drive: motion, truth, recordings of the bus, uploads."""
