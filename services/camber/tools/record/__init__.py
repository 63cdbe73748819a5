"""Recording the bus, playing a recording back, feeding a drive live."""
