"""RTCM 3.3 messages: reference stations, MSM observations and ephemerides, read and written."""
