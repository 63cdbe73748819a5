"""Septentrio's numbers of satellites and signals.

Source: Septentrio mosaic-X5 reference guide, 4.1.9 (satellites), 4.1.10 (signals, with their codes of RINEX).
"""

from __future__ import annotations

import numpy as np

from camber.formats.observations import CHANNEL_STEP_HZ, Floats, Integers, carrier_hz, signal_number

SIGNALS = {
    "G": {0: "1C", 1: "1W", 2: "2W", 3: "2L", 4: "5Q", 5: "1L"},
    "J": {6: "1C", 7: "2L", 26: "5Q", 27: "6L", 32: "1L", 33: "1Z", 38: "1E", 39: "5P"},
    "E": {17: "1C", 19: "6C", 20: "5Q", 21: "7Q", 22: "8Q"},
    "C": {13: "1P", 14: "5P", 28: "2I", 29: "7I", 30: "6I", 34: "7D"},
    "R": {8: "1C", 9: "1P", 10: "2P", 11: "2C", 12: "3Q"},
}
E6_SIGNAL = 19
"""Tracked as `6B` where a flag of the block says so."""
GPS_P_CODES = (1, 2)
"""L1P and L2P, whose C/N0 has no offset."""
_SATELLITES = (
    *(("G", 1, 37, 1), ("J", 181, 190, 1), ("E", 71, 106, 1), ("C", 141, 180, 1), ("C", 223, 245, 41)),
    *(("R", 38, 61, 1), ("R", 63, 68, 25)),
)
"""System, first and last number, and that of the first in RINEX."""
_SIGNAL_NUMBERS = 64  # five bits, and as many again from 32 on


def satellite_of_svid(svid: int) -> tuple[str, int]:
    """Return system letter and number of RINEX; an empty letter for systems that are not supported."""
    for system, first, last, number in _SATELLITES:
        if first <= svid <= last:
            return system, svid - first + number
    return "", 0


def _tables() -> tuple[Integers, Integers, Integers, Floats, Floats]:
    satellites, systems = np.zeros(256, np.int64), np.zeros(_SIGNAL_NUMBERS, np.int64)
    signals, carriers = np.zeros(_SIGNAL_NUMBERS, np.int64), np.full(_SIGNAL_NUMBERS, np.nan)
    channel_steps = np.zeros(_SIGNAL_NUMBERS)
    for svid in range(256):
        system, number = satellite_of_svid(svid)
        satellites[svid] = ord(system) * 256 + number if system else 0
    for system, names in SIGNALS.items():
        for number, name in names.items():
            systems[number], signals[number] = ord(system), signal_number(name)
            carriers[number] = carrier_hz(system, name)
            channel_steps[number] = CHANNEL_STEP_HZ.get(name[0], 0.0) if system == "R" else 0.0
    return satellites, systems, signals, carriers, channel_steps


SATELLITE_OF_SVID, SYSTEM_OF_SIGNAL, SIGNAL_OF_NUMBER, CARRIER_OF_SIGNAL_HZ, CHANNEL_OF_SIGNAL_HZ = _tables()
"""Satellite by SVID (0: not supported); by signal number its system letter as ASCII, signal (0: none), carrier, and the
distance of frequency channels (0: it has none)."""
