"""One epoch of rover and base → a tentative position, by itself: float from code, integers, fixed position.

No fix is carried into the next, so no wrong one is: what goes on is a float position from code, as a prior and only if
asked for. Arcs and the last integers are remembered to say how one fix goes with another. No map and no height enters:
the height is the check, and must stay one.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from camber.formats.observations import Ephemeris, Floats, Integers, ObservationEpoch
from camber.gnss.ambiguity.continuity import Continuity, ContinuityTracker, FixedIntegers
from camber.gnss.ambiguity.fixed_solution import CONTRADICTORY, FAR, IMPRECISE, NO_POSITION, Estimate, Limits
from camber.gnss.ambiguity.resolution import INVALID, RATIO_TOO_LOW, RESOLVED, SEARCH_CUT, UNLIKELY
from camber.gnss.observations.base_station import BaseStation
from camber.gnss.observations.cycle_slips import ArcTracker
from camber.gnss.observations.ephemeris_store import EphemerisStore, Lack
from camber.gnss.observations.epoch_order import EpochOrder
from camber.gnss.observations.signal_pairs import groups_of
from camber.gnss.observations.single_differences import Masks, Noise, Rows
from camber.gnss.position.differenced_epoch import NO_PRIOR, Prior, Sky, columns_of, solve_differenced
from camber.gnss.position.doppler_prior import DopplerPrior
from camber.gnss.position.single_point import NO_IONOSPHERE, SinglePoint, single_point
from camber.gnss.velocity.doppler_velocity import DopplerVelocity, doppler_velocity

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
    FAR: "no_convergence",
}
"""By status of an estimate: why there is no fix."""
Warning_ = Literal[
    "base_silent",
    "base_stale",
    "base_out_of_order",
    "base_time_went_back",
    "base_position_missing",
    "base_position_wrong",
    "ephemeris_missing",
    "rover_out_of_order",
    "rover_time_went_back",
    "rover_clock_step",
]
"""`base_position_wrong`: the base's own single point contradicts its coordinate. `ephemeris_missing`: of a satellite.
`rover_clock_step`: the receiver set its clock, as many do by a millisecond now and then; nothing depends on it."""
_NS = 1e-9
_CLOCK_STEP_M, _LONGEST_STEP_NS = 3.0e4, 2_000_000_000


@dataclass(frozen=True, slots=True)
class EngineOptions:
    """Masks, tests and what is used; bands by the letter of a group of systems (QZSS goes with GPS).

    `failure_rate` above 0 takes the ratio that keeps it in place of `least_ratio`. `doppler_aided`: the float position
    has that of the epoch before, moved by the Doppler velocity, as a prior; without it every epoch stands alone.
    """

    bands: dict[str, str] = field(default_factory=lambda: {"G": "125", "E": "157", "C": "12567"})
    lowest_elevation_rad: float = math.radians(10.0)
    least_cn0_dbhz: float = 30.0
    code_outlier: float = 3.5
    least_ratio: float = 3.0
    failure_rate: float = 0.0
    least_success: float = 0.95
    least_fixed: int = 4
    most_nodes: int = 20_000
    partial: bool = True
    normal_quantile: float = 3.72
    largest_sigma_m: float = 0.10
    longest_age_s: float = 10.0
    ephemerides_of_satellite: int = 8
    doppler_aided: bool = True
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
            self.failure_rate,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """One epoch's tentative position in ECEF (3,), covariance (3, 3); None where there is none.

    `rows` and `estimate` are those of the differenced epoch: what other estimates of it are made from.
    In streets reflected codes agree with one another: the covariance of a `float` or `single` position bounds nothing.
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
    velocity: DopplerVelocity | None = None
    approximate_ecef_m: Floats | None = None
    rows: Rows | None = None
    estimate: Estimate | None = None
    prior: Prior | None = None


class Engine:
    """Feeds on ephemerides, epochs of the base and epochs of the rover, in the order in which they come.

    Nothing that an epoch or an ephemeris holds raises an exception; what is not sure is not `fixed`, with a reason.
    """

    def __init__(self, options: EngineOptions, base_ecef_m: Floats | None = None) -> None:
        self.ephemerides = EphemerisStore(options.ephemerides_of_satellite)
        self.ionosphere = NO_IONOSPHERE
        """Coefficients (8,) of the broadcast ionosphere as in `klobuchar_m`, for positions of one receiver."""
        self.base = BaseStation(base_ecef_m)
        self.reasons: Counter[str] = Counter()
        """Epochs by `Solution.reason`."""
        self.warnings: Counter[Warning_] = Counter()
        """Epochs, of the rover where nothing else is said, by what was amiss."""
        self._options = options
        self._limits = options.limits()
        self._masks = Masks(options.lowest_elevation_rad, options.least_cn0_dbhz)
        self._groups = groups_of(options.bands)
        self._rover_arcs = ArcTracker()
        self._order = EpochOrder()
        self._continuity = ContinuityTracker()
        self._last: SinglePoint | None = None
        self._prior = DopplerPrior()

    def add_ephemeris(self, ephemeris: Ephemeris) -> None:
        """A broadcast ephemeris came."""
        self.ephemerides.add(ephemeris)

    def add_base(self, epoch: ObservationEpoch) -> None:
        """The base has observed."""
        order = self.base.add(epoch)
        if order == "late":
            self.warnings["base_out_of_order"] += 1
        elif order == "anew":
            self.warnings["base_time_went_back"] += 1

    def set_base_position(self, base_ecef_m: Floats) -> None:
        """The base told where it is (3,), for the first time or anew."""
        if self.base.move_to(base_ecef_m):
            self._continuity.forget()

    def lacks(self) -> dict[str, Lack]:
        """By name, the satellites of the rover's last epoch without an ephemeris, and why; for health."""
        last = self._last
        return {} if last is None else self.ephemerides.lacks(last.time_ns, last.satellite)

    def solve(self, rover: ObservationEpoch) -> Solution:
        """The tentative position of one epoch."""
        solution = self._solve(rover)
        self.reasons[solution.reason] += 1
        return solution

    def _solve(self, rover: ObservationEpoch) -> Solution:
        order = self._order.admit(rover.time_ns)
        if order == "late":
            self.warnings["rover_out_of_order"] += 1
            return Solution(rover.time_ns, "none", "out_of_order", None, None, 0)
        if order == "anew":
            self.warnings["rover_time_went_back"] += 1
        arcs = self._rover_arcs.update(rover)
        single = single_point(rover, self.ephemerides, ionosphere=self.ionosphere)
        velocity = doppler_velocity(rover, single)
        prior = self._prior.at(velocity, single) if self._options.doppler_aided else NO_PRIOR
        ephemeris = self.ephemerides.rows_at(rover.time_ns, single.satellite)
        self._warn_of_rover(single, ephemeris)
        base, position = self.base.epoch, self.base.position_ecef_m
        reason, age_s = self._no_base(rover.time_ns)
        if reason is not None or base is None or position is None:
            return _single(rover.time_ns, single, velocity, reason or "no_base")
        start = prior.position_ecef_m if prior is not NO_PRIOR else single.approximate_ecef_m
        approximate, satellites, rows, found = solve_differenced(
            columns_of(rover),
            columns_of(base),
            base.time_ns,
            Sky(single.codes.place, ephemeris, single.states),
            self.ephemerides.table,
            self._groups,
            start if np.isfinite(start[0]) else position,
            position,
            abs(age_s),
            prior,
            self._options.noise,
            self._masks,
            self._limits,
        )
        if found.status in (NO_POSITION, FAR):
            return _single(rover.time_ns, single, velocity, REASON[found.status])
        self._prior.keep(velocity, single, approximate + found.float_dx_m, found.float_covariance_m2)
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
            velocity,
            approximate,
            rows,
            found,
            prior,
        )

    def _no_base(self, time_ns: int) -> tuple[str | None, float]:
        """Why there is nothing to be differenced with, and how old the base's epoch is [s]."""
        base = self.base
        if base.epoch is None:
            self.warnings["base_silent"] += 1
            return "no_base", math.inf
        if base.position_ecef_m is None:
            self.warnings["base_position_missing"] += 1
            return "no_base_position", math.inf
        age_s = (time_ns - base.epoch.time_ns) * _NS
        if not abs(age_s) <= self._options.longest_age_s:
            self.warnings["base_stale"] += 1
            return "base_too_old", age_s
        if base.coordinate(self.ephemerides, self.ionosphere) == "implausible":
            self.warnings["base_position_wrong"] += 1
            return "base_position_wrong", age_s
        return None, age_s

    def _warn_of_rover(self, single: SinglePoint, ephemeris: Integers) -> None:
        if (ephemeris < 0).any():
            self.warnings["ephemeris_missing"] += 1
        if self._last is not None:
            # The drift of a quartz is a thousandth of this.
            step_m = np.abs(single.clock_m - self._last.clock_m)
            if 0 < single.time_ns - self._last.time_ns <= _LONGEST_STEP_NS and (step_m > _CLOCK_STEP_M).any():
                self.warnings["rover_clock_step"] += 1
        self._last = single

    def _compare(
        self, time_ns: int, rows: Rows, found: Estimate, rover_arcs: Integers
    ) -> tuple[Continuity, int | None]:
        """How the integers of a fix go with those of the last; without all integers there is no evidence."""
        known = np.flatnonzero(~np.isnan(found.integer))
        if known.size == 0:
            return "no_evidence", None
        arc = np.column_stack((rover_arcs[rows.rover[known]], self.base.arcs[rows.base[known]]))
        integers = FixedIntegers(
            rows.satellite[known], rows.group[known], found.integer[known].astype(np.int64), arc
        )
        return self._continuity.update(time_ns, integers)


def _single(time_ns: int, single: SinglePoint, velocity: DopplerVelocity, reason: str) -> Solution:
    """The position of the rover alone, where there is one."""
    if single.status != "ok":
        return Solution(time_ns, "none", reason, None, None, 0, single=single, velocity=velocity)
    return Solution(
        time_ns,
        "single",
        reason,
        single.position_ecef_m,
        single.covariance_ecef_m2,
        int(single.used.sum()),
        single=single,
        velocity=velocity,
    )
