"""Position and velocity blocks of one epoch: PVTGeodetic, PosCovGeodetic, VelCovGeodetic.

Source: Septentrio mosaic-X5 reference guide, position blocks. Floats of -2e10 are "not available".
"""

from __future__ import annotations

import struct

from camber.formats.receiver.reported_covariance import reported_covariance
from camber.formats.receiver.solution import (
    Fields,
    ReceiverSolution,
    SolutionQuality,
    checked_position,
    covariance_from_accuracies,
)
from camber.formats.sbf.block_time import TIME_STAMP

PVT_GEODETIC, POS_COV_GEODETIC, VEL_COV_GEODETIC, END_OF_PVT = 4007, 5906, 5908, 5921
"""Numbers of the blocks of an epoch."""
_PVT = struct.Struct("<BB3d5fdfBBBBHHIB")
_ACCURACIES = struct.Struct("<B2x2xHH")  # from revision 2 on, after those of revision 0
_COVARIANCE = struct.Struct("<BB10f")
# `Mode`, bits 0 to 3. Left out: 0 none, 3 a fixed location, which is not measured. With a moving base (7, 8) the vector
# from it is precise, the position no better than the base's own.
_QUALITIES = {
    1: SolutionQuality.SINGLE,
    2: SolutionQuality.DGPS,
    4: SolutionQuality.FIX,
    5: SolutionQuality.FLOAT,
    6: SolutionQuality.SBAS,
    7: SolutionQuality.SINGLE,
    8: SolutionQuality.SINGLE,
    10: SolutionQuality.PPP,
}
_TYPE_BITS, _TWO_DIMENSIONAL = 0b1111, 1 << 7
_UNKNOWN_FLOAT = -2e10  # mosaic-X5 reference guide, do-not-use values
_UNKNOWN_BYTE, _UNKNOWN_SHORT = 0xFF, 0xFFFF
_RAIM = ("unknown", "passed", "failed", "unknown")  # `AlertFlag`, bits 0 and 1


class PvtEpoch:
    """The blocks received so far with one time."""

    def __init__(self, time_ns: int) -> None:
        self.time_ns = time_ns
        self.raim: str | None = None
        """As PVTGeodetic says; None without one."""
        self.signals_used = 0
        """Bits by signal number."""
        self._position: Fields = {}
        self._covariances: Fields = {}

    def take(self, number: int, body: bytes) -> None:
        """Decode one block of this epoch; ValueError or struct.error where it is malformed."""
        fields = body[TIME_STAMP.size :]
        if number == PVT_GEODETIC:
            self.raim = "unknown"
            self._position = self._read_pvt(fields)
        elif number == POS_COV_GEODETIC:
            self._read_covariance("covariance_enu_m2", fields)
        else:
            self._read_covariance("velocity_covariance_enu_m2_s2", fields)

    @property
    def lacks_position(self) -> bool:
        """Whether the receiver reports no position in three dimensions, or one without PVTGeodetic."""
        return not self._position and (self.raim is not None or bool(self._covariances))

    def solution(self) -> ReceiverSolution | None:
        """Return the position of PVTGeodetic, with the covariances where they were sent."""
        if not self._position:
            return None
        return ReceiverSolution(time_ns=self.time_ns, **(self._position | self._covariances))

    def _read_pvt(self, fields: bytes) -> Fields:
        mode, error, latitude, longitude, height, *rest = _PVT.unpack_from(fields)
        _, north, east, up, _, _, _, _, _, satellites, _, _, age, signals, alert = rest
        self.raim = _RAIM[alert & 0b11]
        self.signals_used = signals
        quality = _QUALITIES.get(mode & _TYPE_BITS)
        if quality is None or error or mode & _TWO_DIMENSIONAL:
            return {}
        if _UNKNOWN_FLOAT in (latitude, longitude, height):
            return {}
        velocity = None if _UNKNOWN_FLOAT in (east, north, up) else (east, north, up)
        return {
            **checked_position(latitude, longitude, height),
            "quality": quality,
            "satellites": None if satellites == _UNKNOWN_BYTE else satellites,
            "age_s": None if age == _UNKNOWN_SHORT else age / 100.0,
            "velocity_enu_m_s": velocity,
            "covariance_enu_m2": _covariance_from_accuracies(fields[_PVT.size :]),
        }

    def _read_covariance(self, name: str, fields: bytes) -> None:
        mode, error, nn, ee, uu, _, ne, nu, _, eu, *_ = _COVARIANCE.unpack_from(fields)
        if mode & _TYPE_BITS == 0 or error or _UNKNOWN_FLOAT in (nn, ee, uu, ne, nu, eu):
            return
        covariance = reported_covariance((ee, ne, eu, nn, nu, uu))
        if covariance is not None:
            self._covariances[name] = covariance


def _covariance_from_accuracies(fields: bytes) -> tuple[float, ...] | None:
    """Return the covariance that `HAccuracy` and `VAccuracy` [cm], twice the standard deviations, allow to assume."""
    if len(fields) < _ACCURACIES.size:
        return None
    _, horizontal, vertical = _ACCURACIES.unpack_from(fields)
    if not (0 < horizontal < _UNKNOWN_SHORT and 0 < vertical < _UNKNOWN_SHORT):
        return None
    return covariance_from_accuracies(horizontal / 200.0, vertical / 200.0)
