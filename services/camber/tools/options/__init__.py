"""Command-line options and error reports that several tools share."""
