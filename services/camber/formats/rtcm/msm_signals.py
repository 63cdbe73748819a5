"""Message numbers, satellite counts and signal ids of RTCM 3 MSM messages.

Source: RTCM 10403.3, tables 3.5-76 (messages), 3.5-91, 3.5-96, 3.5-99, 3.5-105, 3.5-108 (signal ids); BeiDou's newer
signals by amendment 1. Carriers by the systems' interface specifications, as in RINEX 3.04, tables 4 to 9.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import (
    GPS_MINUS_BDT_NS,
    SPEED_OF_LIGHT_M_S,
    Floats,
    Integers,
    carrier_hz,
    signal_number,
)

METRES_PER_MS = SPEED_OF_LIGHT_M_S * 1e-3
_SIGNAL_IDS = {
    "G": "2:1C 3:1P 4:1W 8:2C 9:2P 10:2W 15:2S 16:2L 17:2X 22:5I 23:5Q 24:5X 30:1S 31:1L 32:1X",
    "E": "2:1C 3:1A 4:1B 5:1X 6:1Z 8:6C 9:6A 10:6B 11:6X 12:6Z 14:7I 15:7Q 16:7X 18:8I 19:8Q 20:8X 22:5I 23:5Q 24:5X",
    "J": "2:1C 9:6S 10:6L 11:6X 15:2S 16:2L 17:2X 22:5I 23:5Q 24:5X 30:1S 31:1L 32:1X",
    "C": "2:2I 3:2Q 4:2X 8:6I 9:6Q 10:6X 14:7I 15:7Q 16:7X 22:5D 23:5P 24:5X 25:7D 30:1D 31:1P 32:1X",
    "R": "2:1C 3:1P 8:2C 9:2P",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class MsmSystem:
    """A system: its letter, the number of its MSM7 message, the number of satellites in the mask."""

    letter: str
    message: int
    satellites: int
    gps_offset_ns: int = 0


MSM_SYSTEMS = (
    MsmSystem(letter="G", message=1077, satellites=63),
    MsmSystem(letter="E", message=1097, satellites=50),
    MsmSystem(letter="J", message=1117, satellites=10),
    MsmSystem(letter="C", message=1127, satellites=63, gps_offset_ns=GPS_MINUS_BDT_NS),
)
"""In the order in which their messages are sent."""
GLONASS_MSM = MsmSystem(letter="R", message=1087, satellites=24)
"""Read alone: a message gives phases in metres, and an epoch's observations do not name the frequency channels."""
MSM_SYSTEMS_READ = (*MSM_SYSTEMS, GLONASS_MSM)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MsmSignals:
    """The signals, sorted by `keys` (letter × 65536 + signal): index of the system, id, carrier."""

    keys: Integers
    system: Integers
    ids: Integers
    carriers_hz: Floats

    def rows(self, satellite: Integers, signal: Integers) -> tuple[Integers, NDArray[np.bool_]]:
        """Return the row of each satellite's signal, and whether the signal is in the table at all."""
        key = (satellite >> 8 << 16) + signal
        row = np.minimum(np.searchsorted(self.keys, key), self.keys.size - 1)
        return row, self.keys[row] == key


def _signals(systems: tuple[MsmSystem, ...]) -> MsmSignals:
    table = sorted(
        ((ord(system.letter) << 16) + signal_number(name), k, int(number), carrier_hz(system.letter, name))
        for k, system in enumerate(systems)
        for number, name in (entry.split(":") for entry in _SIGNAL_IDS[system.letter].split())
    )
    keys, system, ids, carriers_hz = (np.array(column) for column in zip(*table, strict=True))
    return MsmSignals(keys=keys, system=system, ids=ids, carriers_hz=carriers_hz)


MSM_SIGNALS = _signals(MSM_SYSTEMS)
MSM_SIGNALS_READ = _signals(MSM_SYSTEMS_READ)
