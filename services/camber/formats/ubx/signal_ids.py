"""u-blox' numbers of satellites and signals: one table both to encode messages and to decode them.

Source: u-blox ZED-F9P, interface description (UBX-18010854), 1.5.2 to 1.5.4; ZED-X20P the same, with Galileo's E6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import MAX_SATELLITE_NUMBER, Integers, signal_number

GNSS_IDS = {"G": 0, "E": 2, "C": 3, "J": 5, "R": 6}
SIGNAL_IDS = {
    "G": {"1C": 0, "2L": 3, "2S": 4, "5I": 6, "5Q": 7},
    # Data and pilot tracked together have no id and are encoded as the pilot.
    "E": {
        **{"1C": 0, "1X": 0, "1B": 1, "5I": 3, "5Q": 4, "5X": 4, "7I": 5, "7Q": 6, "7X": 6},
        **{"6B": 8, "6C": 9},
    },
    "C": {"2I": 0, "7I": 2, "6I": 4, "1P": 5, "1D": 6, "5P": 7, "5D": 8},
    "J": {"1C": 0, "1Z": 1, "2S": 4, "2L": 5, "5I": 8, "5Q": 9},
    "R": {"1C": 0, "2C": 2},
}
# B1I, B2I, B3I of geostationary satellites carry D2 and have other ids.
_GEOSTATIONARY_IDS = {0: 1, 2: 3, 4: 10}
GEOSTATIONARY_CYCLES = 0.5
"""Half cycle missing in u-blox' phases of geostationary satellites, compared with other receivers: RTKLIB adds it
(`ublox.c`, from 2.4.3 on). The interface description does not mention it."""
# GLONASS is read alone: RXM-RAWX names the frequency channel, which an epoch's observations do not.
_KEYS = np.array(
    sorted(
        (ord(s) << 16) + signal_number(name) for s, names in SIGNAL_IDS.items() for name in names if s != "R"
    )
)
_IDS = np.array([SIGNAL_IDS[chr(key >> 16)][chr(key >> 8 & 255) + chr(key & 255)] for key in _KEYS.tolist()])
_GNSS_ID = np.zeros(128, np.int64)
_GNSS_ID[[ord(letter) for letter in GNSS_IDS]] = list(GNSS_IDS.values())


def are_geostationary(satellite: Integers) -> NDArray[np.bool_]:
    """Return which of the satellites (n,) are those of BeiDou that send D2: C01 to C05, C59 to C63."""
    number = satellite & 255
    geostationary: NDArray[np.bool_] = (satellite >> 8 == ord("C")) & ((number <= 5) | (number >= 59))
    return geostationary


def ubx_signal_ids(satellite: Integers, signal: Integers) -> tuple[Integers, Integers, NDArray[np.bool_]]:
    """Return u-blox' numbers of system and signal of each row (n,), and which rows have one."""
    system = satellite >> 8
    key = (system << 16) + signal
    index = np.minimum(np.searchsorted(_KEYS, key), _KEYS.size - 1)
    signal_id = _IDS[index]
    geostationary = are_geostationary(satellite)
    for d1, d2 in _GEOSTATIONARY_IDS.items():
        signal_id = np.where(geostationary & (signal_id == d1), d2, signal_id)
    return _GNSS_ID[np.where(system < 128, system, 0)], signal_id, _KEYS[index] == key


def _decoding_tables() -> tuple[Integers, Integers, Integers]:
    letters, numbers, signals = (
        np.zeros(256, np.int64),
        np.zeros(256, np.int64),
        np.zeros((256, 256), np.int64),
    )
    for letter, gnss_id in GNSS_IDS.items():
        letters[gnss_id], numbers[gnss_id] = ord(letter), MAX_SATELLITE_NUMBER[letter]
        # Where several signals share an id, the first in the table, the pilot, is assigned last.
        for name, signal_id in reversed(SIGNAL_IDS[letter].items()):
            signals[gnss_id, signal_id] = signal_number(name)
    for d1, d2 in _GEOSTATIONARY_IDS.items():
        signals[GNSS_IDS["C"], d2] = signals[GNSS_IDS["C"], d1]
    return letters, numbers, signals


SYSTEM_OF_GNSS, MAX_NUMBER_OF_GNSS, SIGNAL_OF_IDS = _decoding_tables()
"""By u-blox' numbers: letter as ASCII (0: not supported), greatest satellite number, signal (gnss, signal; 0: none)."""
