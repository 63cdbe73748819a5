"""Results of the engine become messages field by field; what is not known stays so; the last epochs are remembered."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from camber.formats.observations import ObservationEpoch, satellite_number, signal_number
from camber.geodesy.ellipsoid import ecef_from_geodetic_scalar
from camber.gnss.ambiguity.fixed_solution import CONTRADICTORY
from camber.gnss.candidates import engine_candidates as engine_side
from camber.gnss.candidates.engine_candidates import (
    RecentEpochs,
    enu_covariance,
    fix_from_solution,
    observations_from,
    velocity_from,
)
from camber.gnss.candidates.satellite_subsets import SubsetCandidate
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.rtk_engine import Solution
from camber.gnss.velocity.heading_filter import HeadingEstimate
from camber.gnss.warm_up import warm_up
from camber.schemas.gnss import EstimatesRequest, Fix

NS = 1_000_000_000
TIME_NS = 1_400_000_001 * NS
LATITUDE, LONGITUDE, HEIGHT_M = math.radians(35.17), math.radians(-58.4), 47.25
PLACE = np.array(ecef_from_geodetic_scalar(LATITUDE, LONGITUDE, HEIGHT_M))
SOLVED = warm_up()


def estimate(**changed: Any) -> Any:
    assert SOLVED.estimate is not None
    return SOLVED.estimate._replace(**changed)


FIXED = replace(
    SOLVED,
    position_ecef_m=PLACE,
    covariance_ecef_m2=np.diag([1e-4, 4e-4, 9e-4]),
    satellites=11,
    ratio=7.5,
    age_s=-0.1,
    continuity="continuous",
    continuous_since_ns=TIME_NS - NS,
)
SINGLE = Solution(
    time_ns=TIME_NS,
    quality="single",
    reason="base_too_old",
    position_ecef_m=PLACE,
    covariance_ecef_m2=np.eye(3),
    satellites=8,
)


def published(solved: Solution, datum: str = "WGS84", **given: Any) -> Fix:
    fix = fix_from_solution(solved, datum, **given)
    assert fix is not None
    return fix


def rotated(covariance: np.ndarray) -> np.ndarray:
    """By differences of places: how the local east, north and up axes lie in ECEF, without a rotation matrix."""
    step = 1e-6

    def at(dlat: float, dlon: float, dup: float) -> np.ndarray:
        return np.array(ecef_from_geodetic_scalar(LATITUDE + dlat, LONGITUDE + dlon, HEIGHT_M + dup))

    axes = np.array([at(*d) - at(*(-np.array(d))) for d in ((0, step, 0), (step, 0, 0), (0, 0, 10.0))])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    return axes @ covariance @ axes.T


def test_every_field_of_a_fixed_epoch_is_published() -> None:
    fix = published(FIXED, datum="JGD2011", base_station="rtcm-7", subset_agreement="agree")
    message = estimate()
    assert (fix.time_ns, fix.fix_id) == (SOLVED.time_ns, SOLVED.time_ns // 1_000_000)
    assert (fix.origin, fix.quality) == ("engine", "fixed")
    assert fix.latitude_rad == pytest.approx(LATITUDE, abs=1e-12)
    assert fix.longitude_rad == pytest.approx(LONGITUDE, abs=1e-12)
    assert fix.height_m == pytest.approx(HEIGHT_M, abs=1e-6)
    assert (fix.datum, fix.base_station, fix.satellites, fix.ratio) == ("JGD2011", "rtcm-7", 11, 7.5)
    assert (fix.age_of_corrections_s, fix.ambiguities_fixed) == (0.1, message.fixed)
    assert fix.success_rate == message.success_rate
    assert (fix.ambiguity_continuity, fix.continuous_since_ns) == ("continuous", TIME_NS - NS)
    assert (fix.phase_residuals, fix.subset_agreement) == ("consistent", "agree")
    assert fix.covariance_enu_m2 is not None


@pytest.mark.parametrize(
    ("quality", "of_estimate", "residuals"),
    [
        ("float", {"status": 1}, "unknown"),
        ("float", {"status": CONTRADICTORY}, "contradictory"),
        ("fixed", {"phase_freedom": 0}, "unknown"),  # no more phases than unknowns
    ],
)
def test_what_is_not_fixed_or_not_tested_is_published_so(
    quality: Any, of_estimate: dict[str, int], residuals: str
) -> None:
    fix = published(replace(FIXED, quality=quality, estimate=estimate(**of_estimate)))
    assert (fix.quality, fix.phase_residuals) == (quality, residuals)
    assert (fix.ambiguities_fixed is None) == (fix.success_rate is None) == (quality == "float")


def test_a_position_of_the_rover_alone_has_no_ratio_and_no_age_and_without_one_there_is_no_fix() -> None:
    fix = published(SINGLE)
    unknown = (fix.ratio, fix.age_of_corrections_s, fix.ambiguities_fixed, fix.success_rate)
    assert (fix.quality, *unknown) == ("single", None, None, None, None)
    assert (fix.ambiguity_continuity, fix.continuous_since_ns) == ("no_evidence", None)
    nowhere = Solution(time_ns=TIME_NS, quality="none", reason="too_few_satellites")
    assert fix_from_solution(nowhere, "WGS84") is None


def test_a_position_that_nobody_can_have_is_refused() -> None:
    impossible: tuple[dict[str, Any], ...] = (
        {"position_ecef_m": 1e4 * PLACE},
        {"covariance_ecef_m2": np.full((3, 3), np.nan)},
    )
    for changed in impossible:
        with pytest.raises(ValidationError):
            fix_from_solution(replace(FIXED, **changed), "WGS84")


def test_a_covariance_is_turned_as_the_axes_are() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        half = rng.normal(size=(3, 3))
        expected = rotated(half @ half.T)[np.triu_indices(3)]
        assert enu_covariance(PLACE, half @ half.T) == pytest.approx(expected, abs=1e-6)


def test_velocity_and_heading_are_published_with_their_errors() -> None:
    assert SOLVED.velocity is not None
    moving = replace(
        SOLVED.velocity,
        velocity_enu_m_s=np.array([1.0, -2.0, 0.25]),
        covariance_enu_m2_s2=np.array([[4.0, 0.1, 0.2], [0.1, 5.0, 0.3], [0.2, 0.3, 6.0]]),
        hdop=1.25,
    )
    heading = HeadingEstimate(heading_rad=2.5, heading_sigma_rad=0.01)
    published = velocity_from(moving, heading)
    assert published is not None
    assert published.time_ns == SOLVED.time_ns
    assert published.velocity_enu_m_s == (1.0, -2.0, 0.25)
    assert published.covariance_enu_m2_s2 == (4.0, 0.1, 0.2, 5.0, 0.3, 6.0)
    assert (published.hdop, published.satellites) == (1.25, int(moving.used.sum()))
    assert (published.heading_rad, published.heading_sigma_rad) == (2.5, 0.01)
    still = velocity_from(moving, None)
    assert still is not None
    assert (still.heading_rad, still.heading_sigma_rad) == (None, None)
    assert velocity_from(replace(moving, status="inconsistent"), None) is None


def observed(rows: int = 6) -> ObservationEpoch:
    return ObservationEpoch(
        time_ns=TIME_NS,
        satellite=np.array([satellite_number(f"G{n:02d}") for n in range(1, rows + 1)], np.int64),
        signal=np.full(rows, signal_number("1C"), np.int64),
        pseudorange_m=np.arange(rows) + 2e7,
        carrier_phase_cycles=np.arange(rows) + 1e8,
        doppler_hz=np.arange(rows) - 2.0,
        cn0_dbhz=np.arange(rows) + 40.0,
        lock_time_s=np.arange(rows) + 0.0005,
        loss_of_lock=np.zeros(rows, np.bool_),
        half_cycle=np.zeros(rows, np.bool_),
    )


def test_observations_say_by_a_bit_each_what_a_row_has() -> None:
    epoch = observed()
    columns = ("pseudorange_m", "carrier_phase_cycles", "doppler_hz", "cn0_dbhz", "lock_time_s")
    for row, column in enumerate(columns):
        getattr(epoch, column)[row] = np.nan
    epoch.loss_of_lock[0], epoch.half_cycle[1] = True, True
    epoch.loss_of_lock[2] = epoch.half_cycle[2] = True
    published = observations_from(epoch, "rover")
    assert published.present.tolist() == [0b11110, 0b11101, 0b11011, 0b10111, 0b01111, 0b11111]
    assert published.slip.tolist() == [1, 2, 3, 0, 0, 0]
    assert (published.time_ns, published.station) == (TIME_NS, "rover")
    assert published.satellite.tolist() == epoch.satellite.tolist()
    assert published.signal.tolist() == epoch.signal.tolist()
    for row, column in enumerate(columns[:4]):
        expected = getattr(epoch, column).tolist()
        expected[row] = 0.0  # and the bit says that it is none
        assert getattr(published, column).tolist() == expected
    assert published.lock_time_ns.tolist() == [500_000 + n * NS for n in range(4)] + [0, 5 * NS + 500_000]
    assert observations_from(observed(0), "rover").satellite.size == 0


SOLVED_ID = SOLVED.time_ns // 1_000_000


def recent(*solutions: Solution) -> RecentEpochs:
    epochs = RecentEpochs(EngineSettings())
    for each in solutions:
        epochs.keep(each)
    return epochs


def ask(epochs: RecentEpochs, fix_id: int, **request: Any) -> Any:
    return epochs.estimates(EstimatesRequest(time_ns=TIME_NS, fix_id=fix_id, **request))


def test_other_estimates_are_of_the_epoch_that_was_asked_for() -> None:
    epochs = recent(SOLVED)
    answer = ask(epochs, SOLVED_ID, maximum_trials=6)
    assert (answer.status, answer.trials, answer.reason) == ("available", 6, "")
    assert 1 <= len(answer.candidates) <= 6
    assert SOLVED.position_ecef_m is not None
    for candidate in answer.candidates:
        place = ecef_from_geodetic_scalar(candidate.latitude_rad, candidate.longitude_rad, candidate.height_m)
        assert np.linalg.norm(place - SOLVED.position_ecef_m) < 0.05
        assert len(candidate.excluded_satellites) >= 1
        assert candidate.ambiguities >= EngineSettings().least_fixed
        assert candidate.ratio >= EngineSettings().least_ratio
    named = answer.candidates[0].excluded_satellites
    (one,) = ask(epochs, SOLVED_ID, strategy="explicit", excluded_satellites=named).candidates
    assert one.excluded_satellites == named


def test_an_epoch_is_remembered_for_twenty_more_and_then_forgotten() -> None:
    epochs = recent(*(replace(SOLVED, time_ns=TIME_NS + n * NS // 10) for n in range(21)))
    first, second = TIME_NS // 1_000_000, TIME_NS // 1_000_000 + 100
    assert ask(epochs, first).status == "forgotten"
    assert ask(epochs, first).reason == "not among the last 20 epochs"
    assert ask(epochs, second, maximum_trials=1).status == "available"


def test_an_epoch_without_differences_says_why_there_are_no_estimates() -> None:
    answer = ask(recent(SINGLE), TIME_NS // 1_000_000)
    assert (answer.status, answer.reason, answer.candidates) == ("unavailable", "base_too_old", ())


def test_no_more_candidates_are_published_than_an_answer_can_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    other = SubsetCandidate(
        position_ecef_m=PLACE,
        covariance_ecef_m2=np.eye(3),
        excluded=("G01",),
        ambiguities=9,
        fixed=8,
        ratio=1e12,
        success_rate=0.99,
        agreeing=3,
    )

    monkeypatch.setattr(engine_side, "subset_candidates", lambda *_, **__: (150, [other] * 150))
    answer = ask(recent(SOLVED), SOLVED_ID, maximum_trials=150)
    assert (answer.trials, len(answer.candidates)) == (150, 100)
    first = answer.candidates[0]
    assert (first.ambiguities, first.ratio, first.agreeing_subsets) == (8, 1e9, 3)
