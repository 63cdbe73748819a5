"""The pose filter: dead reckoning, wheel slip, anchors, scan matches, initialization."""
