"""Baselines: decisions of simpler judges on the same fixes.

    ratio_test_only  every fix that passed the ratio test is confirmed
    height_only      |(h_m + h_a) − h_r| ≤ fixed tolerance is confirmed, else erroneous: JP7707657B2 eq. (2) alone
    always_unknown   nothing is confirmed: trivially safe

*Height only* takes road elevation h_m and antenna height h_a from the recorded pose and antenna height, no older than
their channels allow; where either is unknown, so is the decision. It has no start-up rule (provisional poses count), no
uncertainties, no horizontal check, no verification and no learned correction.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from camber.formats.drive.recording import Recorded
from camber.schemas.antenna import AntennaHeight
from camber.schemas.base import Float64
from camber.schemas.channels import BY_NAME
from camber.schemas.gnss import Fix
from camber.schemas.pose import Pose
from camber.validation.fix_statistics import CandidateFixes, FixDecisions, Flags


def baseline_decisions(
    fixes: CandidateFixes, difference_m: Float64, tolerance_m: float
) -> dict[str, FixDecisions]:
    """Decisions of each baseline; `difference_m` (n,) by `height_differences_m`."""
    every, none = np.ones(len(fixes.time_ns), bool), np.zeros(len(fixes.time_ns), bool)
    return {
        "ratio_test_only": _decisions(fixes, every, none),
        "height_only": _decisions(
            fixes, np.abs(difference_m) <= tolerance_m, np.abs(difference_m) > tolerance_m
        ),
        "always_unknown": _decisions(fixes, none, none),
    }


def height_differences_m(
    fixes: Sequence[Fix], poses: Sequence[Recorded[Pose]], heights: Sequence[Recorded[AntennaHeight]]
) -> Float64:
    """(h_m + h_a) − h_r [m] for each fix (n,), NaN where road or antenna height was not known at its time."""
    pose_at = _Latest([(item.message.time_ns, _elevation_m(item.message)) for item in poses], "pose")
    antenna_at = _Latest(
        [(item.message.time_ns, _antenna_m(item.message)) for item in heights], "antenna_height"
    )
    return np.array(
        [pose_at(fix.time_ns) + antenna_at(fix.time_ns) - fix.height_m for fix in fixes], dtype=np.float64
    )


class _Latest:
    """The latest value at or before a time; NaN where it is older than the channel allows."""

    def __init__(self, values: list[tuple[int, float]], channel: str) -> None:
        values = sorted(values, key=lambda item: item[0])
        self._times = [time_ns for time_ns, _ in values]
        self._values = [value for _, value in values]
        self._max_age_ns = (BY_NAME[channel].max_age_s or np.inf) * 1e9

    def __call__(self, time_ns: int) -> float:
        last = bisect_right(self._times, time_ns) - 1
        if last < 0 or time_ns - self._times[last] > self._max_age_ns:
            return float("nan")
        return self._values[last]


def _elevation_m(pose: Pose) -> float:
    elevation_m = pose.road.elevation_m if pose.road.status == "known" else None
    return float("nan") if elevation_m is None else elevation_m


def _antenna_m(height: AntennaHeight) -> float:
    return height.height_m if height.status == "known" and height.height_m is not None else float("nan")


def _decisions(fixes: CandidateFixes, confirmed: Flags, erroneous: Flags) -> FixDecisions:
    unknown = ~(confirmed | erroneous)
    return FixDecisions(
        confirmed=confirmed,
        erroneous=erroneous,
        unknown=unknown,
        unknown_count=int(unknown.sum()),
        confirmed_time_ns=fixes.time_ns[confirmed],
        confirmed_error_m=fixes.error_m[confirmed],
    )
