"""The engine's results as messages, and the recent epochs, for which the judge may request re-estimation."""

from __future__ import annotations

from collections import OrderedDict
from typing import Literal

import numpy as np

from camber.formats.observations import Floats, ObservationEpoch
from camber.geodesy.covariance import EnuCovariance
from camber.gnss.ambiguity.fixed_solution import CONTRADICTORY
from camber.gnss.candidates.receiver_candidates import fix_id_of
from camber.gnss.candidates.satellite_subsets import SubsetCandidate, subset_candidates
from camber.gnss.observations.satellite_states import enu_from_ecef_rotation, geodetic
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.rtk_engine import Solution
from camber.gnss.velocity.doppler_velocity import DopplerVelocity
from camber.gnss.velocity.heading_filter import HeadingEstimate
from camber.schemas.gnss import (
    Candidate,
    Estimates,
    EstimatesRequest,
    Fix,
    Observations,
    SatelliteVelocity,
    SubsetAgreement,
)

_KEPT = 20  # epochs; chosen: two seconds at 10 Hz, and the judge asks within one


def fix_from_solution(
    solution: Solution,
    datum: str,
    base_station: str | None = None,
    subset_agreement: SubsetAgreement = "unknown",
) -> Fix | None:
    """The candidate fix of an epoch, with the name of its base; None where there is no position.

    Raises ValidationError for a position that no Fix can have, such as one near the centre of the earth.
    """
    if solution.quality == "none" or solution.position_ecef_m is None or solution.covariance_ecef_m2 is None:
        return None
    latitude, longitude, height_m = geodetic(solution.position_ecef_m)
    estimate = solution.estimate
    residuals: Literal["consistent", "contradictory", "unknown"] = "unknown"
    if estimate is not None and estimate.status == CONTRADICTORY:
        residuals = "contradictory"
    elif estimate is not None and solution.quality == "fixed" and estimate.phase_freedom > 0:
        residuals = "consistent"
    fixed = estimate if solution.quality == "fixed" else None
    return Fix(
        time_ns=solution.time_ns,
        fix_id=fix_id_of(solution.time_ns),
        origin="engine",
        quality=solution.quality,
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=height_m,
        covariance_enu_m2=enu_covariance(solution.position_ecef_m, solution.covariance_ecef_m2),
        datum=datum,
        satellites=min(solution.satellites, 255),
        ratio=None if solution.ratio is None else min(solution.ratio, 1e9),
        age_of_corrections_s=None if solution.age_s is None else abs(solution.age_s),
        ambiguities_fixed=None if fixed is None else fixed.fixed,
        success_rate=None if fixed is None else fixed.success_rate,
        ambiguity_continuity=solution.continuity,
        continuous_since_ns=solution.continuous_since_ns,
        ambiguity_mode=solution.ambiguity_mode,
        phase_residuals=residuals,
        base_station=base_station,
        subset_agreement=subset_agreement,
    )


def velocity_from(velocity: DopplerVelocity, heading: HeadingEstimate | None) -> SatelliteVelocity | None:
    """Velocity and heading; None where the Dopplers gave no velocity."""
    if velocity.status != "ok":
        return None
    east, north, up = (float(v) for v in velocity.velocity_enu_m_s)
    return SatelliteVelocity(
        time_ns=velocity.time_ns,
        velocity_enu_m_s=(east, north, up),
        covariance_enu_m2_s2=_upper(velocity.covariance_enu_m2_s2),
        hdop=velocity.hdop,
        satellites=int(velocity.used.sum()),
        heading_rad=None if heading is None else heading.heading_rad,
        heading_sigma_rad=None if heading is None else heading.heading_sigma_rad,
    )


def observations_from(epoch: ObservationEpoch, station: str) -> Observations:
    """Raw observations of one epoch, unchanged."""
    measured = epoch.pseudorange_m, epoch.carrier_phase_cycles, epoch.doppler_hz
    columns = *measured, epoch.cn0_dbhz, epoch.lock_time_s
    present = np.zeros(epoch.satellite.size, np.uint8)
    for bit, column in enumerate(columns):
        present |= (~np.isnan(column)).astype(np.uint8) << np.uint8(bit)
    pseudorange, phase, doppler, cn0, lock_s = (np.nan_to_num(column) for column in columns)
    return Observations(
        time_ns=epoch.time_ns,
        station=station,
        satellite=epoch.satellite.astype(np.int32),
        signal=epoch.signal.astype(np.int32),
        present=present,
        pseudorange_m=pseudorange,
        carrier_phase_cycles=phase,
        doppler_hz=doppler,
        cn0_dbhz=cn0,
        lock_time_ns=np.rint(lock_s * 1e9).astype(np.int64),
        slip=epoch.loss_of_lock.astype(np.uint8) | epoch.half_cycle.astype(np.uint8) << np.uint8(1),
    )


class RecentEpochs:
    """The newest epochs by fix id; only these can be re-estimated."""

    def __init__(self, settings: EngineSettings) -> None:
        self._criteria = settings.fix_criteria()
        self._kept: OrderedDict[int, Solution] = OrderedDict()

    def keep(self, solution: Solution) -> None:
        """Add an epoch; the oldest is dropped."""
        self._kept[fix_id_of(solution.time_ns)] = solution
        while len(self._kept) > _KEPT:
            self._kept.popitem(last=False)

    def estimates(self, request: EstimatesRequest) -> Estimates:
        """All candidates from subsets of one fix's satellites that pass the engine's tests; no height is used."""
        answer = Estimates(time_ns=request.time_ns, fix_id=request.fix_id, status="forgotten")
        solution = self._kept.get(request.fix_id)
        if solution is None:
            return answer.model_copy(update={"reason": f"not among the last {_KEPT} epochs"})
        if solution.rows is None:
            return answer.model_copy(update={"status": "unavailable", "reason": solution.reason})
        trials, subsets = subset_candidates(
            solution,
            self._criteria,
            request.strategy,
            request.excluded_satellites,
            most_trials=request.maximum_trials,
        )
        candidates = tuple(_candidate(subset) for subset in subsets[:100])
        return answer.model_copy(update={"status": "available", "trials": trials, "candidates": candidates})


def _candidate(subset: SubsetCandidate) -> Candidate:
    latitude, longitude, height_m = geodetic(subset.position_ecef_m)
    return Candidate(
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=height_m,
        covariance_enu_m2=enu_covariance(subset.position_ecef_m, subset.covariance_ecef_m2),
        excluded_satellites=subset.excluded[:100],
        ambiguities=subset.fixed,
        ratio=min(subset.ratio, 1e9),
        success_rate=subset.success_rate,
        agreeing_subsets=subset.agreeing,
    )


def enu_covariance(position_ecef_m: Floats, covariance_ecef_m2: Floats) -> EnuCovariance:
    """A covariance (3, 3) in ECEF as (ee, en, eu, nn, nu, uu) at a position (3,)."""
    latitude, longitude, _ = geodetic(position_ecef_m)
    rotation = enu_from_ecef_rotation(latitude, longitude)
    return _upper(rotation @ covariance_ecef_m2 @ rotation.T)


def _upper(matrix: Floats) -> EnuCovariance:
    ee, en, eu, _, nn, nu, _, _, uu = matrix.ravel().tolist()
    return max(ee, 0.0), en, eu, max(nn, 0.0), nu, max(uu, 0.0)
