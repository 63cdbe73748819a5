"""Learning of the height correction, and the causes of a common height difference."""
