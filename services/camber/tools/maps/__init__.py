"""`camber map`: maps that people have become releases; releases are looked at, compared, given away."""
