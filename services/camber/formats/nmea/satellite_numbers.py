"""Satellites by NMEA's numbers.

Source: NMEA 0183 v4.11, 6.3: the system by GNSS system id (from 4.10 on), else by talker. Receivers also use offsets
of their own: u-blox F9 HPG 1.32, interface description (UBX-22008968), satellite identifiers.
"""

from __future__ import annotations

SYSTEM_OF_ID = {"1": "G", "2": "R", "3": "E", "4": "C", "5": "J", "6": "I"}
SYSTEM_OF_TALKER = {"GP": "G", "GL": "R", "GA": "E", "GB": "C", "BD": "C", "GQ": "J", "GI": "I"}
# By system: greatest number in RINEX, offsets.
_NUMBERS = {
    "R": (32, (0, 64)),
    "E": (63, (0, 300)),
    "C": (63, (0, 100, 200, 400)),
    "J": (10, (0, 192)),
    "I": (14, (0,)),
}
# First and last number, system and offset, in sentences of GPS; SBAS 120 is S20.
_GPS_AND_SBAS = ((1, 32, "G", 0), (33, 64, "S", 13), (120, 158, "S", 100))
# And in sentences of several systems without a system id.
_ANY_SYSTEM = (
    *_GPS_AND_SBAS,
    *((65, 96, "R", 64), (193, 202, "J", 192), (301, 363, "E", 300), (401, 463, "C", 400)),
)


def satellite_of(system: str, number: int) -> int | None:
    """Return a satellite as in `camber.formats.observations`; None for a number that the system does not have.

    Without a system (empty) the number alone decides, as before NMEA 4.10.
    """
    if system in _NUMBERS:
        greatest, offsets = _NUMBERS[system]
        ranges = tuple((1 + offset, greatest + offset, system, offset) for offset in offsets)
    else:
        ranges = _GPS_AND_SBAS if system else _ANY_SYSTEM
    return next(
        (
            ord(letter) * 256 + number - offset
            for low, high, letter, offset in ranges
            if low <= number <= high
        ),
        None,
    )
