"""`camber calibrate`: estimate lever arm, antenna height and base-station offset from a recorded drive."""
