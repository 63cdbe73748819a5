"""Are the fixes off by one vector, or led away? Judged by the heights along their own track (`Pose.fixes_offset`).

The localizer estimates, every 100 m, how far the track of the fixes lies off the map by heights alone, and how fast
that grows. No odometry is in it, so that it shows smaller vectors than the independent position does. An offset beyond
`least_chi2` that `least_count` estimates in a row show is a fault. Over a window of T seconds, fixes that are led away
since its begin, or later, are off by d on average and grow by at least 2 d / T; fixes of a base that is off do not
grow. What the estimated growth is nearer to is named: that it is a fault is certain, which of both may change.

Where the fixes step, by other integers, their offset is the one before and the step. It names nothing, as it is no new
evidence, but a fault goes on only if what is left is as significant as what is named: otherwise the fixes have returned
from wrong integers. Metres and seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

TrackFault = Literal["base", "drift"]
_Vector = tuple[float, float]
_Covariance = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackFaultRules:
    """When an offset by heights is a fault.

    `least_chi2` has two degrees of freedom: by chance exp(−χ² / 2) = 1e-6. `common_sigma_m`: the map's places, lever
    arm and the base's frame (docs/theory/integrity.md). A fault ends below `ended_chi2`, 99 %.
    """

    least_chi2: float = 27.6
    least_count: int = 2
    common_sigma_m: float = 0.05
    ended_chi2: float = 9.21


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedTrackOffset:
    """Fix less true place over a window, and its growth in a second: east, north; covariances (ee, en, nn).

    `is_estimate`: of the heights; else it is an earlier one, moved by steps of the fixes since.
    """

    begin_ns: int
    end_ns: int
    east_north_m: _Vector
    covariance_m2: _Covariance
    growth_m_s: _Vector
    growth_covariance: _Covariance
    is_estimate: bool = True

    def chi2(self, common_sigma_m: float) -> float:
        """Of the offset, 2 degrees of freedom; zero where the covariance is none."""
        return _chi2(self.east_north_m, self.covariance_m2, common_sigma_m**2)

    @property
    def kind(self) -> TrackFault:
        """What the growth is nearer to."""
        lasts_s = max(1e-9 * (self.end_ns - self.begin_ns), 1.0)
        (east, north), (east_s, north_s) = self.east_north_m, self.growth_m_s
        constant = _chi2(self.growth_m_s, self.growth_covariance)
        led = east_s - 2.0 * east / lasts_s, north_s - 2.0 * north / lasts_s
        return "base" if _chi2(led, self.growth_covariance) >= constant else "drift"

    def describe(self) -> str:
        """What it is, for an operator."""
        if self.kind == "base":
            return "the track of the fixes is off by one vector, by heights"
        return "fixes are led away by {:+.2f} m/s east, {:+.2f} m/s north, by heights".format(
            *self.growth_m_s
        )


class TrackFaults:
    """Takes estimates in the order of time, any of them repeatedly, and names the fault that they show."""

    def __init__(self, rules: TrackFaultRules) -> None:
        self.rules = rules
        self.fault: JudgedTrackOffset | None = None
        self._base = ""
        self._end_ns = 0
        self._shown = 0  # in a row

    def update(self, offset: JudgedTrackOffset | None, base: str) -> bool:
        """Take the newest estimate of the fixes of a base; returns whether it is a new one."""
        if base != self._base:
            self.fault, self._base, self._shown = None, base, 0  # another base is off by another vector
        if offset is None or offset.end_ns == self._end_ns:
            return False
        self._end_ns = offset.end_ns
        chi2 = offset.chi2(self.rules.common_sigma_m)
        is_significant = chi2 >= self.rules.least_chi2
        self._shown = self._shown + 1 if is_significant and offset.is_estimate else 0
        ended = chi2 < self.rules.ended_chi2 if offset.is_estimate else not is_significant
        if self.fault is not None:
            self.fault = None if ended else self.fault if offset.is_estimate else offset
        if self._shown >= self.rules.least_count:
            self.fault = offset
        return True


def _chi2(vector: _Vector, covariance: _Covariance, more: float = 0.0) -> float:
    (east, north), (ee, en, nn) = vector, covariance
    ee, nn = ee + more, nn + more
    determinant = ee * nn - en * en
    if not (ee > 0.0 and determinant > 0.0):
        return 0.0
    return (nn * east**2 - 2.0 * en * east * north + ee * north**2) / determinant
