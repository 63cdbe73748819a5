"""The summary of recorded messages: a drive of six epochs by hand, then a recorded one."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.formats.drive.recording import Recorded
from camber.formats.drive.truth_csv import read_truth
from camber.geodesy.local_frame import LocalFrame
from camber.replay.run_folder import DriveFacts, RunFacts
from camber.schemas.antenna import AntennaHeight
from camber.schemas.drive import load_manifest
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Position, Verdict
from camber.schemas.motion import Motion
from camber.schemas.pose import Pose, Road
from camber.validation.evaluation import Evaluation, evaluate
from camber.validation.reference_trajectory import ReferenceTrajectory, offset_of, truth_of
from support.gnss_files import read_pos, recording

START_NS = 1_373_000_000_000_000_000
STEP_NS = 200_000_000
FRAME = LocalFrame(0.6, 2.3, 40.0)
OFFSET = (0.1, 0.0, -0.2)
MS = 1_000_000


def wrap(message: Any, arrival_ns: int = 0) -> Recorded[Any]:
    return Recorded(channel="", key="", message=message, source="", sequence=0, arrival_ns=arrival_ns)


def time_ns(epoch: int) -> int:
    return START_NS + epoch * STEP_NS


def geodetic(east: float, north: float, up: float) -> dict[str, float]:
    """A position with this error after the offset; the vehicle is at the frame's origin."""
    enu = (east + OFFSET[0], north + OFFSET[1], up + OFFSET[2])
    return dict(
        zip(("latitude_rad", "longitude_rad", "height_m"), FRAME.geodetic_from_enu(*enu), strict=True)
    )


def fix(epoch: int, error: tuple[float, float, float], *, fix_id: int | None = None, **more: Any) -> Fix:
    values = {"quality": "fixed", "origin": "receiver", "covariance_enu_m2": None} | more
    number = epoch if fix_id is None else fix_id
    return Fix(time_ns=time_ns(epoch), fix_id=number, **geodetic(*error), **values)


def verdict(epoch: int, outcome: str, reason: str = "height_agrees", **more: Any) -> Verdict:
    return Verdict(time_ns=time_ns(epoch), verdict=outcome, reason=reason, **({"fix_id": epoch} | more))


def position(epoch: int, error: tuple[float, float], major_m: float | None, **more: Any) -> Position:
    place: dict[str, Any] = geodetic(*error, 0.0)
    axes = {"semi_major_999_m": major_m, "semi_minor_999_m": major_m, "orientation_rad": 0.0}
    values: dict[str, Any] = {"source": "rtk", "usable": True, "alert_limit_m": 9.0} | place | axes | more
    return Position(time_ns=time_ns(epoch), **values)


def truth(epochs: int = 6) -> ReferenceTrajectory:
    times = np.array([time_ns(i) for i in range(epochs)], dtype=np.int64)
    return ReferenceTrajectory(
        time_ns=times,
        latitude_rad=np.full(epochs, 0.6),
        longitude_rad=np.full(epochs, 2.3),
        height_m=np.full(epochs, 40.0),
    )


def facts(**more: Any) -> DriveFacts:
    values = {"drive": "by hand", "truth": True, "offset_enu_m": OFFSET, "alert_limit_m": 1.5} | more
    return DriveFacts(**values)


def by_hand() -> dict[str, list[Recorded[Any]]]:
    """Six epochs at 5 Hz.

    0 right, confirmed. 1 right, erroneous. 2 wrong by 3 m, erroneous. 3 wrong by 5 m (3, 4, 0), confirmed.
    4 a float, unknown. 5 no fix, unknown.
    """
    fixes = [
        (fix(0, (0.03, 0.04, 0.0)), 0),
        (fix(1, (0.0, 0.0, 0.2)), 200),
        (fix(2, (0.0, 0.0, -3.0)), 400),
        (fix(3, (3.0, 4.0, 0.0)), 600),
        (fix(4, (0.0, 0.0, 0.0), quality="float"), 800),
    ]
    verdicts = [
        (verdict(0, "confirmed"), 1),
        (verdict(1, "erroneous", "height_disagrees"), 202),
        (verdict(2, "erroneous", "height_disagrees"), 403),
        (verdict(3, "confirmed"), 604),
        (verdict(4, "unknown", "not_a_fix"), 810),
        (verdict(5, "unknown", "gnss_stale", fix_id=None), 1000),
    ]
    positions = [
        position(0, (0.0, 0.0), None, source="none"),
        position(0, (0.03, 0.04), 0.1),
        position(1, (0.3, 0.4), 0.6, source="sensors"),
        position(2, (0.6, 0.8), 0.9, source="sensors"),
        position(3, (3.0, 4.0), 0.1),
        position(4, (0.0, 2.0), 3.0, source="sensors"),
    ]
    return {
        "motion": [wrap(Motion(time_ns=time_ns(i))) for i in (*range(6), 5)],
        "fix": [wrap(message, ms * MS) for message, ms in fixes],
        "verdict": [wrap(message, ms * MS) for message, ms in verdicts],
        "position": [wrap(message) for message in positions],
    }


def run(recorded: dict[str, list[Recorded[Any]]], **more: Any) -> dict[str, Any]:
    return evaluate(recorded, facts(**more), RunFacts(speed_factor=50.0), truth()).summary


def test_the_drive_by_hand() -> None:
    s = run(by_hand())
    assert (s["drive"], s["epochs"], s["truth"], s["speed_factor"]) == ("by hand", 6, True, 50.0)
    assert s["tentative"] == {"fixed": 4, "wrong": 2, "truth_unknown": 0}
    assert s["confirmed"] == {"count": 2, "wrong": 1, "truth_unknown": 0}
    assert s["right"] == {"count": 2, "kept": 0.5, "erroneous": 1}
    assert s["unknown"] == {"count": 2, "of_fixed": 0}
    # 2 and 3 are 0.2 s apart: one episode, of which 3 was confirmed.
    assert (s["episodes"]["wrong"], s["episodes"]["missed"], s["episodes"]["longest_s"]) == (1, 1, 0.2)


def test_positions_count_once_an_epoch_by_the_last_one_published() -> None:
    s = run(by_hand())
    # Radii 0.1, 0.6, 0.9, 0.1 are below 1.5 m, 3.0 is not, epoch 5 has no position: 4 of 6.
    assert s["position"]["availability"] == pytest.approx(4 / 6)
    # Five of six epochs have a position, and each says that it is usable.
    assert s["position"]["usable"] == pytest.approx(5 / 6)
    assert s["position"]["horizontal_reference"] == ["required"]
    # Horizontal errors 0.05, 0.5, 1, 2, 5: the median is the third, the others the last.
    assert s["position"]["error_m"] == pytest.approx({"p50": 1.0, "p95": 5.0, "p999": 5.0}, abs=1e-6)


def test_coverage_of_the_ellipse_is_counted_by_source() -> None:
    coverage = run(by_hand())["coverage"]
    # rtk: 0.05 of 0.1 inside both, 5 of 0.1 outside. sensors, as shares of the 99.9 % radius: 0.83 (inside
    # 99.9 %, outside 99 %, whose radius is √(2/3) = 0.816 of it), 1.11 (outside), 0.67 (inside both).
    assert coverage["rtk"] == {"epochs": 2, "inside_99": 0.5, "inside_999": 0.5}
    assert coverage["sensors"] == pytest.approx({"epochs": 3, "inside_99": 1 / 3, "inside_999": 2 / 3})
    assert coverage["all"] == pytest.approx({"epochs": 5, "inside_99": 2 / 5, "inside_999": 3 / 5})


def test_the_stanford_chart_is_counted_by_region() -> None:
    # (error, radius): (0.05, 0.1) (0.5, 0.6) nominal; (1, 0.9) misleading; (5, 0.1) hazardous as well;
    # (2, 3) above the alert limit and within the level.
    assert run(by_hand())["stanford"]["radius_999"] == {
        "epochs": 5, "nominal": 2, "misleading": 2, "hazardous": 1, "unavailable": 1, "unavailable_misleading": 0,
    }  # fmt: skip
    assert run(by_hand())["stanford"]["hpl"]["epochs"] == 0


def test_an_ellipse_has_the_published_orientation() -> None:
    drive = by_hand()
    along = {"semi_major_999_m": 1.0, "semi_minor_999_m": 0.1, "orientation_rad": math.pi / 2}
    drive["position"] = [wrap(position(0, (0.0, 0.7), 1.0, **along))]
    assert run(drive)["coverage"]["rtk"] == {"epochs": 1, "inside_99": 1.0, "inside_999": 1.0}
    for outside in ((0.7, 0.0), (0.0, 1.1)):
        drive["position"] = [wrap(position(0, outside, 1.0, **along))]
        assert run(drive)["coverage"]["rtk"] == {"epochs": 1, "inside_99": 0.0, "inside_999": 0.0}


def test_latency_is_from_fix_to_verdict_at_the_recorder() -> None:
    # 1, 2, 3, 4 and 10 ms; the verdict without a fix has none.
    assert run(by_hand())["latency_ms"] == {"p50": 3.0, "p99": 10.0}


def test_verdicts_are_counted_by_outcome_and_reason() -> None:
    counts = {(e["verdict"], e["reason"]): e["count"] for e in run(by_hand())["verdicts"]["by_reason"]}
    assert counts == {
        ("confirmed", "height_agrees"): 2, ("erroneous", "height_disagrees"): 2,
        ("unknown", "not_a_fix"): 1, ("unknown", "gnss_stale"): 1,
    }  # fmt: skip


def with_heights(*, pose_age: int = 0, status: str = "known") -> dict[str, list[Recorded[Any]]]:
    """The road at 38.0 m and an antenna 1.8 m above it: with the offset, the antenna belongs at 39.8 m."""
    drive = by_hand()
    road = Road(status="known", elevation_m=38.0) if status == "known" else Road(status="unknown")
    drive["pose"] = [
        wrap(Pose(time_ns=time_ns(i) - pose_age, mode="provisional", provenance="fixes", road=road))
        for i in range(6)
    ]
    drive["antenna_height"] = [
        wrap(AntennaHeight(time_ns=time_ns(0), status="known", height_m=1.8, sigma_m=0.02))
    ]
    return drive


def test_the_baselines_judge_the_same_fixes() -> None:
    c = run(with_heights())["controls"]
    assert c["ratio_test_only"]["confirmed"] == {"count": 4, "wrong": 2, "truth_unknown": 0}
    assert (c["ratio_test_only"]["right"]["kept"], c["ratio_test_only"]["episodes"]["missed"]) == (1.0, 1)
    # Height differences 0, −0.2, 3 and 0 m: the horizontal error of 5 m is not seen, and that of 3 m is.
    assert c["height_only"]["confirmed"] == {"count": 3, "wrong": 1, "truth_unknown": 0}
    assert (c["height_only"]["right"]["kept"], c["height_only"]["tolerance_m"]) == (1.0, 0.3)
    assert c["always_unknown"]["confirmed"]["count"] == 0
    assert c["always_unknown"]["unknown"] == {"count": 4, "of_fixed": 4}
    assert c["always_unknown"]["right"]["kept"] == 0.0
    assert run(with_heights(), fixed_tolerance_m=0.1)["controls"]["height_only"]["right"]["kept"] == 0.5


@pytest.mark.parametrize("case", ["no pose", "road unknown", "pose too old"])
def test_without_a_fresh_road_height_only_is_unknown(case: str) -> None:
    drive = {
        "no pose": by_hand(),
        "road unknown": with_heights(status="unknown"),
        "pose too old": with_heights(pose_age=5_000 * MS),
    }[case]
    height_only = run(drive)["controls"]["height_only"]
    assert height_only["unknown"] == {"count": 4, "of_fixed": 4}
    assert height_only["confirmed"]["count"] == 0


def test_without_truth_nothing_that_needs_it_is_a_number() -> None:
    e = evaluate(with_heights(), facts(truth=False), RunFacts(), None)
    s = e.summary
    assert (s["truth"], s["tentative"]["fixed"], s["confirmed"]["count"]) == (False, 4, 2)
    for judge in (s, *s["controls"].values()):
        assert judge["confirmed"]["wrong"] is None
        assert set(judge["right"].values()) == {None}
        assert set(judge["episodes"].values()) == {None}
    assert s["tentative"]["wrong"] is None
    assert set(s["position"]["error_m"].values()) == {None}
    assert (s["coverage"], s["stanford"], e.episodes) == (None, None, [])
    assert s["position"]["availability"] == pytest.approx(4 / 6)
    assert s["speed_factor"] is None


def test_the_position_of_an_epoch_is_the_last_one_within_half_a_step() -> None:
    recorded = by_hand()
    # The motion sensor's clock is 7 ms off that of the receiver.
    recorded["motion"] = [wrap(Motion(time_ns=time_ns(i) + 7 * MS)) for i in range(6)]
    assert run(recorded)["position"]["availability"] == pytest.approx(4 / 6)
    # 120 ms of 200: it is the position after, and radii 0.6, 0.9, 0.1 of 1 to 3 are below the limit.
    recorded["motion"] = [wrap(Motion(time_ns=time_ns(i) + 120 * MS)) for i in range(6)]
    assert run(recorded)["position"]["availability"] == pytest.approx(3 / 6)


def test_an_empty_recording_has_counts_of_zero_and_nothing_else() -> None:
    s = evaluate({}, facts(), RunFacts(), truth()).summary
    assert (s["epochs"], s["tentative"]["fixed"], s["confirmed"]["count"]) == (0, 0, 0)
    assert s["position"]["availability"] is s["position"]["usable"] is None
    assert s["position"]["horizontal_reference"] == []
    assert s["latency_ms"] == {"p50": None, "p99": None}
    assert json.loads(json.dumps(s, allow_nan=False)) == s


def test_a_re_estimated_position_counts_by_its_error_and_not_the_fix_s() -> None:
    drive = by_hand()
    better = verdict(3, "confirmed_after_verification", **geodetic(0.0, 0.0, 0.1))
    drive["verdict"][3] = wrap(better)
    s = run(drive)
    assert s["confirmed"] == {"count": 2, "wrong": 0, "truth_unknown": 0}
    assert (s["tentative"]["wrong"], s["episodes"]["missed"]) == (2, 0)


def test_a_fix_published_again_counts_once() -> None:
    drive = by_hand()
    drive["fix"].append(drive["fix"][3])
    assert run(drive)["tentative"] == {"fixed": 4, "wrong": 2, "truth_unknown": 0}


def test_a_confirmation_is_not_undone_by_a_later_verdict() -> None:
    drive = by_hand()
    drive["verdict"].append(wrap(verdict(3, "erroneous", "height_disagrees")))
    s = run(drive)
    assert (s["confirmed"]["wrong"], s["episodes"]["missed"], s["verdicts"]["repeated"]) == (1, 1, 1)
    assert s["tentative"]["fixed"] == 4
    drive["verdict"].append(wrap(verdict(0, "erroneous", "height_disagrees")))
    assert run(drive)["right"] == {"count": 2, "kept": 0.5, "erroneous": 1}


def test_a_fix_without_a_verdict_is_not_confirmed() -> None:
    drive = by_hand()
    del drive["verdict"][0]
    s = run(drive)
    assert (s["right"]["kept"], s["unknown"]["of_fixed"], s["verdicts"]["fixes_without_verdict"]) == (
        0.0,
        1,
        1,
    )


def test_an_id_used_again_after_a_restart_belongs_to_the_nearest_fix() -> None:
    drive = by_hand()
    drive["fix"] = [wrap(fix(0, (0.0, 0.0, 0.0), fix_id=0)), wrap(fix(5, (9.0, 0.0, 0.0), fix_id=0))]
    drive["verdict"] = [
        wrap(verdict(0, "confirmed", fix_id=0)),
        wrap(verdict(5, "erroneous", "height_disagrees", fix_id=0)),
    ]
    s = run(drive)
    assert (s["confirmed"]["wrong"], s["right"]["kept"], s["erroneous"]["count"]) == (0, 1.0, 1)


def test_a_drive_without_motion_takes_its_epochs_from_the_positions() -> None:
    assert run(by_hand() | {"motion": []})["epochs"] == 5


def nagoya() -> Evaluation:
    recording("nagoya-2023-07-11")
    manifest = load_manifest(Path(__file__).parents[2] / "replay" / "nagoya.toml")
    assert manifest.truth is not None
    assert manifest.receiver is not None
    reference = truth_of(read_truth(manifest.truth.file, manifest.truth.format))
    fixes = [
        Fix(
            time_ns=solution.time_ns, fix_id=i, origin="receiver", quality="fixed",
            latitude_rad=solution.latitude_rad, longitude_rad=solution.longitude_rad,
            height_m=solution.height_m, covariance_enu_m2=None,
        )
        for i, solution in enumerate(read_pos(manifest.receiver.file))
        if not isinstance(solution, ValueError) and int(solution.quality) == 1
    ]  # fmt: skip
    offset = DriveFacts(drive="nagoya", truth=True, offset_enu_m=offset_of(manifest))
    return evaluate({"fix": [wrap(message) for message in fixes]}, offset, RunFacts(), reference)


def test_nagoya_has_114_wrong_fixes_in_30_episodes() -> None:
    evaluation = nagoya()
    s = evaluation.summary
    assert s["tentative"] == {"fixed": 1799, "wrong": 114, "truth_unknown": 0}
    assert (s["right"]["count"], s["right"]["kept"]) == (1678, 0.0)
    assert (s["episodes"]["wrong"], s["episodes"]["cautious"]["wrong"]) == (30, 13)
    ratio_only = s["controls"]["ratio_test_only"]
    assert (ratio_only["confirmed"]["wrong"], ratio_only["episodes"]["missed"]) == (114, 30)
    assert sum(len(episode.fixes) for episode in evaluation.episodes) == 114
    error_m = evaluation.tentative_error_enu_m[evaluation.fix_rows[~evaluation.fixes.wrong]]
    np.testing.assert_allclose(np.median(error_m, axis=0), 0.0, atol=0.01)


def test_levels_are_counted_by_source_with_their_tightness() -> None:
    drive = by_hand()
    levels = {
        "horizontal_protection_level_m": 1.0,
        "vertical_protection_level_m": 3.0,
        "vertical_alert_limit_m": 2.0,
    }
    drive["position"] = [
        wrap(position(0, (0.2, 0.0), 0.5, **levels)),
        wrap(position(1, (1.2, 0.0), 0.5, **levels)),
        wrap(position(2, (0.2, 0.0), 0.5, source="sensors")),
    ]
    by_source = run(drive)["levels"]
    assert set(by_source) == {"rtk", "sensors", "all"}
    hpl = by_source["rtk"]["hpl"]
    assert (hpl["epochs"], hpl["nominal"], hpl["misleading"], hpl["hazardous"]) == (2, 1, 1, 0)
    assert (hpl["median_level_m"], hpl["ratio"]) == (1.0, pytest.approx(1.0 / 0.7))
    assert by_source["rtk"]["vpl"]["unavailable"] == 2
    assert by_source["sensors"]["hpl"]["median_level_m"] is None


def test_the_99_percent_ellipse_is_the_published_one_where_there_is_one() -> None:
    drive = by_hand()
    published = {"semi_major_99_m": 0.6, "semi_minor_99_m": 0.6}
    drive["position"] = [
        wrap(position(0, (0.5, 0.0), 0.55, **published)),
        wrap(position(1, (0.5, 0.0), 0.55)),
    ]
    assert run(drive)["coverage"]["rtk"] == {"epochs": 2, "inside_99": 0.5, "inside_999": 1.0}
