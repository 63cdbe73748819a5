"""RTCM 3.3 messages: base stations, MSM observations and ephemerides, decoded and encoded."""
