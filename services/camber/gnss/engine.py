"""One epoch of rover and base → a tentative position, by itself: float from code, integers, fixed position.

No state is carried from epoch to epoch into a position, so no error is; what is remembered (arcs, the last integers)
only says how one fix goes with another. No map and no height enters: the height is the check, and must stay one.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from camber.formats.observations import Ephemeris, Floats, Integers, ObservationEpoch
from camber.gnss.ambiguity import INVALID, RATIO_TOO_LOW, RESOLVED, SEARCH_CUT, UNLIKELY
from camber.gnss.arcs import ArcTracker
from camber.gnss.continuity import Continuity, ContinuityTracker, FixedIntegers
from camber.gnss.differenced_epoch import Sky, columns_of, solve_differenced
from camber.gnss.ephemeris_store import EphemerisStore
from camber.gnss.fixing import CONTRADICTORY, IMPRECISE, NO_POSITION, Estimate, Limits
from camber.gnss.signals import groups_of
from camber.gnss.single_differences import Masks, Noise, Rows
from camber.gnss.single_point import SinglePoint, single_point

Quality = Literal["fixed", "float", "single", "none"]
REASON = {
    RESOLVED: "resolved",
    RATIO_TOO_LOW: "ratio_too_low",
    UNLIKELY: "success_rate_too_low",
    SEARCH_CUT: "search_cut_off",
    INVALID: "not_definite",
    NO_POSITION: "too_few_satellites",
    CONTRADICTORY: "phases_contradict",
    IMPRECISE: "too_imprecise",
}
"""By status of an estimate: why there is no fix."""
_NS = 1e-9


@dataclass(frozen=True, slots=True)
class EngineOptions:
    """Masks, tests and what is used; bands by the letter of a group of systems (QZSS goes with GPS)."""

    bands: dict[str, str] = field(default_factory=lambda: {"G": "125", "E": "157", "C": "12567"})
    lowest_elevation_rad: float = math.radians(10.0)
    least_cn0_dbhz: float = 30.0
    code_outlier: float = 3.5
    least_ratio: float = 3.0
    least_success: float = 0.95
    least_fixed: int = 4
    most_nodes: int = 20_000
    partial: bool = True
    normal_quantile: float = 3.72
    largest_sigma_m: float = 0.10
    longest_age_s: float = 10.0
    noise: Noise = field(default_factory=Noise)

    def limits(self) -> Limits:
        """As the compiled code takes them."""
        return Limits(
            self.code_outlier,
            self.least_ratio,
            self.least_success,
            self.least_fixed,
            self.most_nodes,
            self.partial,
            self.normal_quantile,
            self.largest_sigma_m,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """One epoch's tentative position in ECEF (3,), covariance (3, 3); None where there is none.

    `rows` and `estimate` are those of the differenced epoch: what other estimates of it are made from.
    """

    time_ns: int
    quality: Quality
    reason: str
    position_ecef_m: Floats | None
    covariance_ecef_m2: Floats | None
    satellites: int
    ratio: float | None = None
    age_s: float | None = None
    continuity: Continuity = "no_evidence"
    continuous_since_ns: int | None = None
    single: SinglePoint | None = None
    approximate_ecef_m: Floats | None = None
    rows: Rows | None = None
    estimate: Estimate | None = None


class Engine:
    """Feeds on ephemerides, epochs of the base and epochs of the rover, in the order in which they come."""

    def __init__(self, options: EngineOptions, base_ecef_m: Floats | None = None) -> None:
        self.ephemerides = EphemerisStore()
        self.reasons: Counter[str] = Counter()
        """Epochs by `Solution.reason`."""
        self._options = options
        self._limits = options.limits()
        self._masks = Masks(options.lowest_elevation_rad, options.least_cn0_dbhz)
        self._groups = groups_of(options.bands)
        self._base_ecef_m = base_ecef_m
        self._base: ObservationEpoch | None = None
        self._rover_arcs, self._base_arcs = ArcTracker(), ArcTracker()
        self._of_base = np.zeros(0, np.int64)
        self._continuity = ContinuityTracker()

    def add_ephemeris(self, ephemeris: Ephemeris) -> None:
        """A broadcast ephemeris came."""
        self.ephemerides.add(ephemeris)

    def add_base(self, epoch: ObservationEpoch) -> None:
        """The base has observed."""
        self._base = epoch
        self._of_base = self._base_arcs.update(epoch)

    def solve(self, rover: ObservationEpoch) -> Solution:
        """The tentative position of one epoch."""
        solution = self._solve(rover)
        self.reasons[solution.reason] += 1
        return solution

    def _solve(self, rover: ObservationEpoch) -> Solution:
        arcs = self._rover_arcs.update(rover)
        single = single_point(rover, self.ephemerides)
        base, position = self._base, self._base_ecef_m
        if base is None or position is None:
            return _single(rover.time_ns, single, "no_base")
        age_s = (rover.time_ns - base.time_ns) * _NS
        if not abs(age_s) <= self._options.longest_age_s:
            return _single(rover.time_ns, single, "base_too_old")
        start = single.approximate_ecef_m
        approximate, satellites, rows, found = solve_differenced(
            columns_of(rover),
            columns_of(base),
            base.time_ns,
            Sky(single.codes.place, self.ephemerides.rows_at(rover.time_ns, single.satellite), single.states),
            self.ephemerides.table,
            self._groups,
            start if np.isfinite(start[0]) else position,
            position,
            self._options.noise,
            self._masks,
            self._limits,
        )
        if found.status == NO_POSITION:
            return _single(rover.time_ns, single, REASON[NO_POSITION])
        fixed = found.status == RESOLVED
        continuity, since_ns = (
            self._compare(rover.time_ns, rows, found, arcs) if fixed else ("no_evidence", None)
        )
        return Solution(
            rover.time_ns,
            "fixed" if fixed else "float",
            REASON[found.status],
            approximate + (found.dx_m if fixed else found.float_dx_m),
            found.covariance_m2 if fixed else found.float_covariance_m2,
            satellites,
            None if np.isnan(found.ratio) else found.ratio,
            age_s,
            continuity,
            since_ns,
            single,
            approximate,
            rows,
            found,
        )

    def _compare(
        self, time_ns: int, rows: Rows, found: Estimate, rover_arcs: Integers
    ) -> tuple[Continuity, int | None]:
        """How the integers of a fix go with those of the last; without all integers there is no evidence."""
        known = np.flatnonzero(~np.isnan(found.integer))
        if known.size == 0:
            return "no_evidence", None
        arc = np.column_stack((rover_arcs[rows.rover[known]], self._of_base[rows.base[known]]))
        integers = FixedIntegers(
            rows.satellite[known], rows.group[known], found.integer[known].astype(np.int64), arc
        )
        return self._continuity.update(time_ns, integers)


def _single(time_ns: int, single: SinglePoint, reason: str) -> Solution:
    """The position of the rover alone, where there is one."""
    if single.status != "ok":
        return Solution(time_ns, "none", reason, None, None, 0, single=single)
    return Solution(
        time_ns,
        "single",
        reason,
        single.position_ecef_m,
        single.covariance_ecef_m2,
        int(single.used.sum()),
        single=single,
    )
