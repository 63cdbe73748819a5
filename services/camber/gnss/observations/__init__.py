"""Observations of rover and base station: streams, cycle slips, ephemerides, single differences."""
