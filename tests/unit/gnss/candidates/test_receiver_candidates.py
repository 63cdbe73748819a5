"""A receiver's solution becomes a fix unchanged; epochs pass once, in order, and not from the future."""

from __future__ import annotations

from dataclasses import replace

import pytest

from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.gnss.candidates.receiver_candidates import fix_from, refuse
from camber.schemas.gnss import Fix

NS = 1_000_000_000
TIME_NS = 1_373_000_000 * NS
SOLUTION = ReceiverSolution(
    time_ns=TIME_NS,
    latitude_rad=0.61,
    longitude_rad=2.39,
    height_m=42.5,
    quality=SolutionQuality.FIX,
    satellites=17,
    covariance_enu_m2=(4e-4, 1e-5, 0.0, 4e-4, 0.0, 1e-3),
    age_s=1.5,
    ratio=8.25,
)


def test_a_solution_is_passed_on_as_it_is() -> None:
    assert fix_from(SOLUTION, "JGD2011") == Fix(
        time_ns=TIME_NS,
        fix_id=TIME_NS // 1_000_000,
        origin="receiver",
        quality="fixed",
        latitude_rad=0.61,
        longitude_rad=2.39,
        height_m=42.5,
        covariance_enu_m2=(4e-4, 1e-5, 0.0, 4e-4, 0.0, 1e-3),
        datum="JGD2011",
        satellites=17,
        ratio=8.25,
        age_of_corrections_s=1.5,
    )


def test_what_the_receiver_did_not_say_stays_unknown() -> None:
    bare = replace(SOLUTION, satellites=None, covariance_enu_m2=None, age_s=None, ratio=None)
    fix = fix_from(bare, "WGS84")
    assert (fix.satellites, fix.covariance_enu_m2, fix.age_of_corrections_s, fix.ratio) == (None,) * 4
    assert (fix.ambiguity_continuity, fix.phase_residuals) == ("no_evidence", "unknown")
    assert fix.base_station is None


def test_the_station_of_the_corrections_is_named_as_the_receiver_calls_it() -> None:
    assert fix_from(replace(SOLUTION, station="VRS 1"), "WGS84").base_station == "station-VRS_1"


@pytest.mark.parametrize(
    ("time_s", "last_s", "expected"),
    [
        (0.0, None, None),
        (-1e6, None, None),
        (0.0, -0.1, None),
        (0.0, 0.0, "repeated_epoch"),
        (-0.1, 0.0, "out_of_order_epoch"),
        (0.5, -0.1, None),
        (0.501, -0.1, "epoch_from_the_future"),
        (0.501, None, "epoch_from_the_future"),
        (0.501, 0.501, "epoch_from_the_future"),
    ],
)
def test_epochs_pass_once_in_order_and_not_from_the_future(
    time_s: float, last_s: float | None, expected: str | None
) -> None:
    last_ns = None if last_s is None else TIME_NS + round(last_s * NS)
    assert refuse(TIME_NS + round(time_s * NS), last_ns, TIME_NS) == expected
