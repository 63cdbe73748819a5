"""Solutions that receivers compute, streams that mix protocols, and what phase measurements share."""
