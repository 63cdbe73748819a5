"""Solutions computed by receivers, streams of several protocols, and properties of carrier phases common to formats."""
