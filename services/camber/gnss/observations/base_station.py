"""The base station: its last epoch, its coordinate, and whether the two are consistent.

A base coordinate error moves every fix by as much, and no test of integers detects it. The base's single-point solution
does: a coordinate of another station, of another datum or with a height above the geoid is outside its covariance. One
epoch detects what is far off at once; the mean of minutes and that of days (`base_offset`) a few metres.
"""

from __future__ import annotations

import re
from typing import Literal

import numpy as np

from camber.formats.observations import Floats, ObservationEpoch
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.observations.base_coordinate_history import Move
from camber.gnss.observations.base_offset import LARGEST_CHI2, BaseOffset, OffsetWindow, as_text, enu_rotation
from camber.gnss.observations.cycle_slips import CycleSlipDetector
from camber.gnss.observations.ephemeris_store import EphemerisStore
from camber.gnss.observations.epoch_order import EpochOrder, Order
from camber.gnss.observations.satellite_states import geodetic
from camber.gnss.position.single_point import SinglePoint, single_point

Coordinate = Literal["plausible", "implausible", "unknown"]
"""`unknown`: the base's epochs gave no position to compare with."""

_LEAST_MISS_M = 20.0  # chosen: errors of a single point under a disturbed ionosphere stay below it
_CHECK_EVERY_NS = 10 * NS_PER_SECOND  # chosen: the coordinate changes with the stream only

_NAME_LENGTH = 64  # of the schema's `Name`
_LABEL_LENGTH = 20  # a coordinate to the millimetre takes up to 41


def station_name(label: str, position_ecef_m: Floats | None = None) -> str:
    """Name that distinguishes one base from another: its label (id, marker), and its coordinate (3,) in ECEF.

    Station numbers repeat from network to network, and a station with a new coordinate moves every fix.
    """
    name = re.sub(r"[^A-Za-z0-9_.:@+-]", "_", label.strip())[:_LABEL_LENGTH]
    if position_ecef_m is not None:
        name += "@" + ":".join(f"{value:.3f}" for value in position_ecef_m)
    return name[:_NAME_LENGTH]


class BaseStation:
    """The current base station; `position_ecef_m` (3,) is None until it is known."""

    def __init__(self, position_ecef_m: Floats | None = None) -> None:
        self.position_ecef_m = position_ecef_m
        self.name = ""
        """As `station_name`, of what the fixes were differenced with."""
        self.epoch: ObservationEpoch | None = None
        self.arcs = np.zeros(0, np.int64)
        """Arc of each row of the epoch (n,), as `CycleSlipDetector.update`."""
        self.miss_ecef_m: Floats | None = None
        """The base's single point less its coordinate (3,) at the last check."""
        self.offset: BaseOffset | None = None
        """Mean offset of the last minutes, None before a minute."""
        self.offset_over_days: BaseOffset | None = None
        """That of earlier days with this coordinate, where it is remembered."""
        self.move: Move | None = None
        """How it has moved since earlier days, where that is not confirmed."""
        self._window = OffsetWindow()
        self._slips, self._order = CycleSlipDetector(), EpochOrder()
        self._checked_ns: int | None = None
        self._coordinate: Coordinate = "unknown"

    def move_to(self, position_ecef_m: Floats) -> bool:
        """Set the base's coordinate (3,) [m]; whether it changed."""
        before = self.position_ecef_m
        changed = before is None or not np.array_equal(position_ecef_m, before)
        if changed:
            self.position_ecef_m = position_ecef_m
            self._checked_ns, self._coordinate, self.miss_ecef_m = None, "unknown", None
            self.offset = self.offset_over_days = self.move = None
            self._window.clear()
        return changed

    def add(self, epoch: ObservationEpoch) -> Order:
        """Add the next epoch; a late one is dropped."""
        order = self._order.admit(epoch.time_ns)
        if order == "late":
            return order
        if order == "restarted":
            self._checked_ns = None
            self._window.clear()
        self.epoch = epoch
        self.arcs = self._slips.update(epoch)
        return order

    def coordinate(self, ephemerides: EphemerisStore, ionosphere: Floats) -> Coordinate:
        """Whether the single points agree with the coordinate; once they do, checked every 10 s."""
        epoch, position = self.epoch, self.position_ecef_m
        if epoch is None or position is None:
            return "unknown"
        if self._checked_ns is not None:
            since_ns = epoch.time_ns - self._checked_ns
            if since_ns == 0 or (self._coordinate == "plausible" and since_ns < _CHECK_EVERY_NS):
                return self._coordinate
        self._checked_ns = epoch.time_ns
        self._coordinate = self._check(epoch, position, ephemerides, ionosphere)
        return self._coordinate

    def coordinate_error(self) -> str:
        """By how much the coordinate is off, as far as it is known, for an operator."""
        wrong = [each for each in (self.offset_over_days, self.offset) if each is not None and each.is_wrong]
        if wrong:
            return wrong[0].coordinate_error()
        if self.miss_ecef_m is None or self.position_ecef_m is None:
            return "not a position on the earth"
        east, north, up = (-(enu_rotation(self.position_ecef_m) @ self.miss_ecef_m)).tolist()
        return f"{as_text((east, north, up))} from its single point"

    def _check(
        self, epoch: ObservationEpoch, position: Floats, ephemerides: EphemerisStore, ionosphere: Floats
    ) -> Coordinate:
        if not np.isfinite(geodetic(position)[0]):
            return "implausible"
        solution = single_point(epoch, ephemerides, ionosphere=ionosphere)
        if solution.status == "ok":
            self.miss_ecef_m = solution.position_ecef_m - position
            self._window.add(epoch.time_ns, self.miss_ecef_m, solution.covariance_ecef_m2)
            self.offset = self._window.offset(position)
            if _is_far(solution, self.miss_ecef_m):
                return "implausible"
        if any(each is not None and each.is_wrong for each in (self.offset, self.offset_over_days)):
            return "implausible"
        return "plausible" if solution.status == "ok" else "unknown"


def _is_far(solution: SinglePoint, miss_ecef_m: Floats) -> bool:
    """Whether one epoch alone contradicts the coordinate."""
    chi2 = float(miss_ecef_m @ np.linalg.solve(solution.covariance_ecef_m2, miss_ecef_m))
    return float(np.linalg.norm(miss_ecef_m)) > _LEAST_MISS_M and chi2 > LARGEST_CHI2
