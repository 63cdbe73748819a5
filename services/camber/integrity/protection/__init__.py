"""Protection levels and error ellipses of the position at every epoch."""
