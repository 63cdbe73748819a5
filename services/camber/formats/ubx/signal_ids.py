"""What u-blox receivers call satellites and signals: one table to write messages with and to read them by.

Source: u-blox ZED-F9P, interface description (UBX-18010854), 1.5.2 to 1.5.4; ZED-X20P likewise, with Galileo's E6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Integers, signal_number

GNSS_IDS = {"G": 0, "E": 2, "C": 3, "J": 5}
SIGNAL_IDS = {
    "G": {"1C": 0, "2L": 3, "2S": 4, "5I": 6, "5Q": 7},
    # There is no id for data and pilot together: what is tracked so is told as the pilot.
    "E": {
        **{"1C": 0, "1X": 0, "1B": 1, "5I": 3, "5Q": 4, "5X": 4, "7I": 5, "7Q": 6, "7X": 6},
        **{"6B": 8, "6C": 9},
    },
    "C": {"2I": 0, "7I": 2, "6I": 4, "1P": 5, "1D": 6, "5P": 7, "5D": 8},
    "J": {"1C": 0, "1Z": 1, "2S": 4, "2L": 5, "5I": 8, "5Q": 9},
}
# B1I, B2I, B3I of geostationary satellites carry D2 and have ids of their own.
GEOSTATIONARY_IDS = {0: 1, 2: 3, 4: 10}
GEOSTATIONARY_CYCLES = 0.5
"""What u-blox' phases of geostationary satellites lack beside other receivers': what RTKLIB adds to them (`ublox.c`,
from 2.4.3 on). The interface description does not speak of it."""
MOST_SATELLITES = {"G": 63, "J": 10, "E": 63, "C": 63}
_KEYS = np.array(
    sorted((ord(s) << 16) + signal_number(name) for s, names in SIGNAL_IDS.items() for name in names)
)
_IDS = np.array([SIGNAL_IDS[chr(key >> 16)][chr(key >> 8 & 255) + chr(key & 255)] for key in _KEYS.tolist()])
_GNSS_ID = np.zeros(128, np.int64)
_GNSS_ID[[ord(letter) for letter in GNSS_IDS]] = list(GNSS_IDS.values())


def are_geostationary(satellite: Integers) -> NDArray[np.bool_]:
    """Which of the satellites (n,) are those of BeiDou that send D2: C01 to C05, C59 to C63."""
    number = satellite & 255
    geostationary: NDArray[np.bool_] = (satellite >> 8 == ord("C")) & ((number <= 5) | (number >= 59))
    return geostationary


def ubx_signal_ids(satellite: Integers, signal: Integers) -> tuple[Integers, Integers, NDArray[np.bool_]]:
    """u-blox' numbers of system and signal of each row (n,), and which rows have one."""
    system = satellite >> 8
    key = (system << 16) + signal
    place = np.minimum(np.searchsorted(_KEYS, key), _KEYS.size - 1)
    signal_id = _IDS[place]
    geostationary = are_geostationary(satellite)
    for d1, d2 in GEOSTATIONARY_IDS.items():
        signal_id = np.where(geostationary & (signal_id == d1), d2, signal_id)
    return _GNSS_ID[np.where(system < 128, system, 0)], signal_id, _KEYS[place] == key


def _reading_tables() -> tuple[Integers, Integers, Integers]:
    letters, most, signals = np.zeros(256, np.int64), np.zeros(256, np.int64), np.zeros((256, 256), np.int64)
    for letter, gnss_id in GNSS_IDS.items():
        letters[gnss_id], most[gnss_id] = ord(letter), MOST_SATELLITES[letter]
        # The pilot's name, where data and pilot together have the same number: it comes first.
        for name, signal_id in reversed(SIGNAL_IDS[letter].items()):
            signals[gnss_id, signal_id] = signal_number(name)
    for d1, d2 in GEOSTATIONARY_IDS.items():
        signals[GNSS_IDS["C"], d2] = signals[GNSS_IDS["C"], d1]
    return letters, most, signals


SYSTEM_OF_GNSS, MOST_OF_GNSS, SIGNAL_OF_IDS = _reading_tables()
"""By u-blox' numbers: letter as ASCII (0: not one of ours), most satellites, signal (gnss, signal; 0: none)."""
