"""NAV-SAT: direction, C/N0 and use of the satellites that the receiver knows to be visible or tracks.

Source: u-blox F9 HPG 1.32, interface description (UBX-22008968), NAV-SAT and satellite identifiers.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from camber.formats.observations import MAX_SATELLITE_NUMBER
from camber.formats.receiver.satellite_report import ReportedSatellite, direction_rad
from camber.formats.ubx.signal_ids import GNSS_IDS
from camber.schemas.gnss import SatelliteUse

_HEADER = struct.Struct("<4xBB2x")
_BLOCK = struct.Struct("<BBBbh2xI")
_VERSION = 1  # NAV-SAT
# By `gnssId`: system letter, greatest `svId`. Other systems have no numbers, nor has GLONASS' 255, "unknown".
_SYSTEMS = {number: (letter, MAX_SATELLITE_NUMBER[letter]) for letter, number in GNSS_IDS.items()}
_SYSTEMS |= {1: ("S", 158), 7: ("I", 14)}
_FIRST_SBAS = 120  # S20 in RINEX
_CODE_LOCKED = 4  # `qualityInd`; below it the signal is searched for, or detected and of no use
_UNHEALTHY = 2  # `health`
_NO_EPHEMERIS = (0, 2)  # `orbitSource`: none, almanac


class NavSatellites(NamedTuple):
    """What NAV-SAT lists, and how many blocks were left out: of an unknown satellite, of one that is listed before."""

    satellites: tuple[ReportedSatellite, ...]
    unknown: int
    repeated: int


def read_satellites(payload: bytes) -> NavSatellites:
    """Decode NAV-SAT; of repeated satellites the first counts. ValueError where it is malformed."""
    version, count = _HEADER.unpack_from(payload) if len(payload) >= _HEADER.size else (None, 0)
    if version != _VERSION or len(payload) != _HEADER.size + count * _BLOCK.size:
        raise ValueError(f"NAV-SAT, version {version}, of {len(payload)} bytes for {count} satellites")
    satellites = dict[int, ReportedSatellite]()
    unknown = 0
    for block in _BLOCK.iter_unpack(payload[_HEADER.size :]):
        gnss_id, number, cn0_dbhz, elevation_deg, azimuth_deg, flags = block
        satellite = _satellite(gnss_id, number)
        if satellite is None:
            unknown += 1
            continue
        direction = direction_rad(azimuth_deg, elevation_deg)
        reported = ReportedSatellite(satellite, direction, float(cn0_dbhz) or None, _use(flags))
        satellites.setdefault(satellite, reported)
    return NavSatellites(tuple(satellites.values()), unknown, count - unknown - len(satellites))


def _satellite(gnss_id: int, number: int) -> int | None:
    letter, greatest = _SYSTEMS.get(gnss_id, ("", 0))
    least = _FIRST_SBAS if letter == "S" else 1
    if not least <= number <= greatest:
        return None
    return ord(letter) * 256 + (number - 100 if letter == "S" else number)


def _use(flags: int) -> SatelliteUse:
    """Return the use; of a satellite left out the first reason that the message contains."""
    if flags >> 3 & 1:
        return "used"
    if flags & 0b111 < _CODE_LOCKED:
        return "no_pseudorange"
    if flags >> 4 & 0b11 == _UNHEALTHY:
        return "unhealthy"
    return "no_ephemeris" if flags >> 8 & 0b111 in _NO_EPHEMERIS else "reason_not_reported"
