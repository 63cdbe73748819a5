"""Contradictions of anchors and odometry: bounds of the sensors' errors; the anchors' path and that of odometry."""
