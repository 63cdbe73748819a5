"""Over simulated drives each method is within its 3 σ, and a tyre that loses air is detected; seeds not used in tuning.

More drives, and the localizer's own matches: `support.antenna_statistics`.
"""

from __future__ import annotations

import pytest

from camber.schemas.antenna import AntennaHeight
from camber.simulator.injected_faults import ChangedLoad, ChangedTyre
from support.antenna_drives import AntennaDrive, antenna_drive, matched_drive, settings_of, slope_drive
from support.antenna_statistics import judged, noticed_after_s, run, status_shares
from support.lidar_drives import HILL


def detected_in_time(drive: AntennaDrive, method: str) -> list[AntennaHeight]:
    """The heights, which are known until a minute after the start and not half a minute later."""
    heights, onset_ns = run(drive, settings_of(way=method)), int(drive.time_ns[0]) + 60_000_000_000
    assert all(one.status == "known" for one in heights[1:] if one.time_ns < onset_ns)
    assert noticed_after_s(drive, heights, onset_ns) <= 30.0
    return heights


@pytest.mark.parametrize("attitude", [True, False])
@pytest.mark.parametrize("grade", [0.0, 0.10, -0.10])
def test_every_method_holds_its_sigma_on_flat_road_and_on_a_grade(grade: float, attitude: bool) -> None:
    drive = slope_drive(9201, grade, 0.02, attitude=attitude, matches=True)
    heights = run(drive, settings_of(way="automatic"))
    assert status_shares(heights)["known"] == 1.0
    assert {one.way for one in heights[50:]} == {"scan_matching" if grade else "ranging"}
    errors_by_method = judged(heights, drive.true_height_m, drive.true_steepness)
    assert set(errors_by_method) == {"fixed", "stroke", "ranging", "scan_matching"}
    for method, errors in errors_by_method.items():
        figures = errors.figures()
        assert figures["within_3_sigma"] >= 0.99
        assert figures["sigma_median_m"] <= 0.025
        assert figures["p95_m"] <= (0.03 if method == "scan_matching" else 0.02)


def test_a_tyre_that_loses_a_centimetre_is_detected_within_thirty_seconds_and_not_before() -> None:
    fault = ChangedTyre(kind="changed_tyre", onset_s=60.0, radius_change_m=-0.01)
    heights = detected_in_time(antenna_drive("open-sky", 9202, faults=[fault]), "stroke")
    assert heights[0].status == "known"
    assert "stroke" in heights[-1].reason
    assert "ranging" in heights[-1].reason


@pytest.mark.parametrize("scenario", ["city", "open-sky"])
@pytest.mark.parametrize(
    "fault",
    [
        ChangedTyre(kind="changed_tyre", onset_s=60.0, radius_change_m=-0.02),
        ChangedLoad(kind="changed_load", onset_s=60.0, load_kg=300.0),
    ],
    ids=["tyre", "load"],
)
def test_a_tyre_or_a_load_is_detected_with_a_matched_height_and_nothing_before(
    scenario: str, fault: ChangedTyre | ChangedLoad
) -> None:
    detected_in_time(antenna_drive(scenario, 9204, faults=[fault], matches=True), "automatic")


@pytest.mark.parametrize("seed", range(9205, 9209))
def test_a_city_with_a_matched_height_raises_no_alarm(seed: int) -> None:
    drive = antenna_drive("city", seed, matches=True)
    heights = run(drive, settings_of(way="automatic"))
    assert status_shares(heights)["disagreement"] == 0.0


def test_on_a_grade_scan_matching_of_the_localizer_holds_its_sigma() -> None:
    """Six seconds up the steepest part of a hill."""
    drive = matched_drive(HILL, 9203, start_s=48.0, duration_s=6.0)
    heights = run(drive, settings_of(way="scan_matching"))
    errors_by_method = judged(heights, drive.true_height_m, drive.true_steepness)["scan_matching"]
    assert len(errors_by_method.error_m) > 40
    assert min(errors_by_method.steepness) > 0.06
    figures = errors_by_method.figures()
    assert figures["within_3_sigma"] >= 0.99
    assert figures["sigma_median_m"] <= 0.025
    assert figures["p95_m"] <= 0.03
