"""RTK engine: one epoch of rover and base → a candidate fix.

No fix is carried into the next epoch, so no wrong one is: only a float position from code is propagated, as a prior, if
`doppler_aided`. Arcs and the last integers are remembered to report the continuity of fixes. No map and no height is
used: the height must remain an independent check.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.compiled.decorator import require_numba
from camber.formats.observations import BroadcastEphemeris, Floats, Integers, ObservationEpoch
from camber.gnss.ambiguity.ambiguity_resolution import INVALID, RATIO_TOO_LOW, RESOLVED, SEARCH_CUT, UNLIKELY
from camber.gnss.ambiguity.continuity import Continuity, ContinuityTracker, fixed_integers
from camber.gnss.ambiguity.fixed_solution import CONTRADICTORY, FAR, IMPRECISE, NO_POSITION, Estimate
from camber.gnss.observations.base_station import BaseStation
from camber.gnss.observations.cycle_slips import CycleSlipDetector
from camber.gnss.observations.differenced_observations import Noise, SingleDifferences
from camber.gnss.observations.differential_age import base_use
from camber.gnss.observations.ephemeris_store import EphemerisStore, MissingReason
from camber.gnss.observations.epoch_order import EpochOrder
from camber.gnss.observations.signal_pairs import columns_of
from camber.gnss.position.carried_ambiguities import AmbiguityMode, CarriedAmbiguities
from camber.gnss.position.carried_solution import EpochRows
from camber.gnss.position.doppler_prior import DopplerPrior, velocity_in_ecef
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.epoch_solution import EngineParameters, SatelliteView, solve_epoch
from camber.gnss.position.float_solution import NO_PRIOR, PositionPrior
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
"""Reason for no fix by status of an estimate."""
EngineWarning = Literal[
    "base_silent",
    "base_stale",
    "base_out_of_order",
    "base_time_went_back",
    "base_position_missing",
    "base_position_wrong",
    "base_moved",
    "ephemeris_missing",
    "rover_out_of_order",
    "rover_time_went_back",
    "rover_clock_step",
]
"""`base_position_wrong`: the base's own single points contradict its coordinate. `base_moved`: it is not the one of
earlier days, and not confirmed. `ephemeris_missing`: of a satellite.
`rover_clock_step`: the receiver stepped its clock, as many do by a millisecond now and then; harmless."""
_CLOCK_STEP_M = 3.0e4  # chosen: 0.1 ms, a tenth of the usual step of 1 ms
_LONGEST_STEP_NS = 2_000_000_000  # chosen: over a longer gap drift and step cannot be separated


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Solution:
    """One epoch's position in ECEF (3,), covariance (3, 3); None where there is none. `fixed`: a candidate fix.

    `rows`, `approximate_ecef_m`, `estimate` and `prior` are those of the differenced epoch, for re-estimation from
    satellite subsets. In streets multipath errors agree with one another: the covariance of a `float` or `single`
    position is no bound.
    """

    time_ns: int
    quality: Quality
    reason: str
    position_ecef_m: Floats | None = None
    covariance_ecef_m2: Floats | None = None
    satellites: int = 0
    ratio: float | None = None
    age_s: float | None = None
    continuity: Continuity = "no_evidence"
    continuous_since_ns: int | None = None
    single: SinglePoint | None = None
    velocity: DopplerVelocity | None = None
    approximate_ecef_m: Floats | None = None
    rows: SingleDifferences | None = None
    estimate: Estimate | None = None
    prior: PositionPrior = NO_PRIOR
    ambiguity_mode: AmbiguityMode = "single_epoch"


class Engine:
    """Consumes ephemerides, epochs of the base and epochs of the rover, in the order of arrival.

    Nothing that an epoch or an ephemeris holds raises an exception; what is not certain is not `fixed`, with a reason.
    """

    def __init__(self, settings: EngineSettings, base_ecef_m: Floats | None = None) -> None:
        require_numba()
        self.ephemerides = EphemerisStore(settings.ephemerides_of_satellite)
        self.ionosphere = NO_IONOSPHERE
        """Coefficients (8,) of the broadcast ionosphere as in `klobuchar_m`, for positions of one receiver."""
        self.base = BaseStation(base_ecef_m)
        self.reasons: Counter[str] = Counter()
        """Epochs by `Solution.reason`."""
        self.warnings: Counter[EngineWarning] = Counter()
        """Epochs by warning: of the base for `base_…`, else of the rover."""
        self._settings = settings
        self._parameters = EngineParameters(
            settings.groups(), Noise(), masks=settings.masks(), criteria=settings.fix_criteria()
        )
        self._slips = CycleSlipDetector()
        self._order = EpochOrder()
        self._continuity = ContinuityTracker()
        self._last: SinglePoint | None = None
        self._prior = DopplerPrior()
        self._carried = (
            CarriedAmbiguities(self._parameters.noise, self._parameters.criteria)
            if settings.ambiguities == "carried"
            else None
        )

    def add_ephemeris(self, ephemeris: BroadcastEphemeris) -> None:
        """Add a broadcast ephemeris."""
        self.ephemerides.add(ephemeris)

    def add_base(self, epoch: ObservationEpoch) -> None:
        """Add an epoch of the base."""
        order = self.base.add(epoch)
        if order == "late":
            self.warnings["base_out_of_order"] += 1
        elif order == "restarted":
            self.warnings["base_time_went_back"] += 1

    def set_base_position(self, base_ecef_m: Floats) -> None:
        """Set the base's coordinate (3,)."""
        if self.base.move_to(base_ecef_m):
            self._continuity.reset()
            if self._carried is not None:
                self._carried.reset()

    def missing_ephemerides(self) -> dict[str, MissingReason]:
        """Satellites of the rover's last epoch without an ephemeris, by name, with the reason; for health."""
        last = self._last
        return {} if last is None else self.ephemerides.missing(last.time_ns, last.satellite)

    def solve(self, rover: ObservationEpoch) -> Solution:
        """Solve one epoch of the rover with the last epoch of the base."""
        solution = self._solve(rover)
        self.reasons[solution.reason] += 1
        return solution

    def _solve(self, rover: ObservationEpoch) -> Solution:
        order = self._order.admit(rover.time_ns)
        if order == "late":
            self.warnings["rover_out_of_order"] += 1
            return Solution(time_ns=rover.time_ns, quality="none", reason="out_of_order")
        if order == "restarted":
            self.warnings["rover_time_went_back"] += 1
        arcs = self._slips.update(rover)
        single = single_point(rover, self.ephemerides, ionosphere=self.ionosphere)
        velocity = doppler_velocity(rover, single)
        prior = self._prior.at(velocity, single) if self._settings.doppler_aided else NO_PRIOR
        ephemeris = self.ephemerides.rows_at(rover.time_ns, single.satellite)
        self._warn_of_rover(single, ephemeris)
        base, base_ecef_m = self.base.epoch, self.base.position_ecef_m
        reason, age_s = self._base_use(rover.time_ns)
        if reason is not None or base is None or base_ecef_m is None:
            return _single(single, velocity, reason or "no_base")
        start = prior.position_m if prior is not NO_PRIOR else single.approximate_ecef_m
        approximate, satellites, rows, estimate = solve_epoch(
            rover=columns_of(rover),
            base=columns_of(base),
            sky=SatelliteView(single.codes.place, ephemeris, single.states, self.ephemerides.table),
            start_ecef_m=start if np.isfinite(start[0]) else base_ecef_m,
            base_ecef_m=base_ecef_m,
            prior=prior,
            parameters=self._parameters,
        )
        if estimate.status in (NO_POSITION, FAR):
            return _single(single, velocity, REASON[estimate.status])
        float_ecef_m = approximate + estimate.float_dx_m
        self._prior.keep(velocity, single, float_ecef_m, estimate.float_covariance_m2)
        mode: AmbiguityMode = "single_epoch"
        if self._carried is not None:
            epoch = EpochRows(
                rows=rows,
                rover_arc=arcs[rows.rover],
                base_arc=self.base.arcs[rows.base],
                base_cn0_dbhz=base.cn0_dbhz[rows.base],
                time_ns=rover.time_ns,
                approximate_ecef_m=approximate,
            )
            mode, estimate = self._carried.solve(epoch, estimate, velocity_in_ecef(velocity, single))
            float_ecef_m = approximate + estimate.float_dx_m
        fixed = estimate.status == RESOLVED
        continuity, since_ns = (
            self._compare(rover.time_ns, rows, estimate, arcs) if fixed else ("no_evidence", None)
        )
        return Solution(
            time_ns=rover.time_ns,
            quality="fixed" if fixed else "float",
            reason=REASON[estimate.status],
            position_ecef_m=approximate + estimate.dx_m if fixed else float_ecef_m,
            covariance_ecef_m2=estimate.covariance_m2 if fixed else estimate.float_covariance_m2,
            satellites=satellites,
            ratio=None if np.isnan(estimate.ratio) else estimate.ratio,
            age_s=age_s,
            continuity=continuity,
            continuous_since_ns=since_ns,
            single=single,
            velocity=velocity,
            approximate_ecef_m=approximate,
            rows=rows,
            estimate=estimate,
            prior=prior,
            ambiguity_mode=mode,
        )

    def _base_use(self, time_ns: int) -> tuple[str | None, float]:
        """Reason why the base's epoch cannot be used, if so, and the correction age [s]."""
        use = base_use(
            self.base,
            time_ns,
            self.ephemerides,
            ionosphere=self.ionosphere,
            longest_age_s=self._settings.longest_base_age_s,
        )
        if use.warning is not None:
            self.warnings[use.warning] += 1
        return use.reason, use.age_s

    def _warn_of_rover(self, single: SinglePoint, ephemeris: Integers) -> None:
        if (ephemeris < 0).any():
            self.warnings["ephemeris_missing"] += 1
        if self._last is not None:
            step_m = np.abs(single.clock_m - self._last.clock_m)
            if 0 < single.time_ns - self._last.time_ns <= _LONGEST_STEP_NS and (step_m > _CLOCK_STEP_M).any():
                self.warnings["rover_clock_step"] += 1
        self._last = single

    def _compare(
        self, time_ns: int, rows: SingleDifferences, estimate: Estimate, rover_arcs: Integers
    ) -> tuple[Continuity, int | None]:
        """Continuity of a fix with the last one; without all integers there is no evidence."""
        integers = fixed_integers(rows, estimate.integer, rover_arcs, self.base.arcs)
        if integers.size == 0:
            return "no_evidence", None
        return self._continuity.update(time_ns, integers)


def _single(single: SinglePoint, velocity: DopplerVelocity, reason: str) -> Solution:
    """The single-point solution of the rover, where there is one."""
    ok = single.status == "ok"
    return Solution(
        time_ns=single.time_ns,
        quality="single" if ok else "none",
        reason=reason,
        position_ecef_m=single.position_ecef_m if ok else None,
        covariance_ecef_m2=single.covariance_ecef_m2 if ok else None,
        satellites=int(single.used.sum()) if ok else 0,
        single=single,
        velocity=velocity,
    )
