"""The base: its last epoch, its coordinate, and whether the two belong together.

A fix is as right as the base's coordinate: a wrong one moves every fix by as much, and no test of integers sees it. The
base's own single point does: a coordinate of another station, of another datum or with a height above the geoid lies
outside of what its covariance allows.
"""

from __future__ import annotations

import re
from typing import Literal

import numpy as np

from camber.formats.observations import Floats, ObservationEpoch
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.observations.cycle_slips import ArcTracker
from camber.gnss.observations.ephemeris_store import EphemerisStore
from camber.gnss.observations.epoch_order import EpochOrder, Order
from camber.gnss.observations.satellite_states import geodetic
from camber.gnss.position.single_point import single_point

Coordinate = Literal["plausible", "implausible", "unknown"]
"""`unknown`: the base's own epochs gave no position to compare with."""

_LEAST_MISS_M = 20.0
_LARGEST_CHI2 = 36.0  # three degrees of freedom: 1e-7 by chance
_CHECK_EVERY_NS = 10 * NS_PER_SECOND

_NAME_LENGTH = 64  # of `Name`
_TOLD_LENGTH = 20  # a coordinate to the millimetre takes up to 41


def station_name(told: str, position_ecef_m: Floats | None = None) -> str:
    """By what one base is told from another: what it calls itself (id, marker), and its coordinate (3,) in ECEF.

    Numbers of stations repeat from network to network, and a station that is given another coordinate moves every fix.
    """
    name = re.sub(r"[^A-Za-z0-9_.:@+-]", "_", told.strip())[:_TOLD_LENGTH]
    if position_ecef_m is not None:
        name += "@" + ":".join(f"{value:.3f}" for value in position_ecef_m)
    return name[:_NAME_LENGTH]


class BaseStation:
    """One base at a time; `position_ecef_m` (3,) is None until it is known."""

    def __init__(self, position_ecef_m: Floats | None = None) -> None:
        self.position_ecef_m = position_ecef_m
        self.epoch: ObservationEpoch | None = None
        self.arcs = np.zeros(0, np.int64)
        """Of each row of the epoch (n,), as `ArcTracker.update`."""
        self.miss_m: float | None = None
        """How far the base's own single point was from its coordinate at the last check."""
        self._tracker, self._order = ArcTracker(), EpochOrder()
        self._checked_ns: int | None = None
        self._coordinate: Coordinate = "unknown"

    def move_to(self, position_ecef_m: Floats | None) -> bool:
        """The base's coordinate (3,) [m] became known, or changed: whether it is another one than before."""
        before = self.position_ecef_m
        if position_ecef_m is None or before is None:
            changed = position_ecef_m is not before
        else:
            changed = not np.array_equal(position_ecef_m, before)
        if changed:
            self.position_ecef_m = position_ecef_m
            self._checked_ns, self._coordinate, self.miss_m = None, "unknown", None
        return changed

    def add(self, epoch: ObservationEpoch) -> Order:
        """Its next epoch; a late one is not taken."""
        order = self._order.admit(epoch.time_ns)
        if order == "late":
            return order
        if order == "anew":
            self._checked_ns = None
        self.epoch = epoch
        self.arcs = self._tracker.update(epoch)
        return order

    def coordinate(self, ephemerides: EphemerisStore, ionosphere: Floats) -> Coordinate:
        """Whether the last epoch's single point goes with the coordinate; then it is looked at now and then."""
        epoch, position = self.epoch, self.position_ecef_m
        if epoch is None or position is None:
            return "unknown"
        if self._checked_ns is not None:
            since_ns = epoch.time_ns - self._checked_ns
            if since_ns == 0 or (self._coordinate == "plausible" and since_ns < _CHECK_EVERY_NS):
                return self._coordinate
        self._checked_ns = epoch.time_ns
        self._coordinate, self.miss_m = _coordinate(epoch, position, ephemerides, ionosphere)
        return self._coordinate


def _coordinate(
    epoch: ObservationEpoch, position: Floats, ephemerides: EphemerisStore, ionosphere: Floats
) -> tuple[Coordinate, float | None]:
    if not np.isfinite(geodetic(position)[0]):
        return "implausible", None
    found = single_point(epoch, ephemerides, ionosphere=ionosphere)
    if found.status != "ok":
        return "unknown", None
    miss = found.position_ecef_m - position
    miss_m = float(np.linalg.norm(miss))
    chi2 = float(miss @ np.linalg.solve(found.covariance_ecef_m2, miss))
    return ("implausible" if miss_m > _LEAST_MISS_M and chi2 > _LARGEST_CHI2 else "plausible"), miss_m
