"""The report of one drive: one HTML page with its data inside."""
