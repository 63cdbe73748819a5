"""No verdict and no east or north of a fix changes a bit of the independent position; matches and heights do."""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.schemas.codec import encode
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from camber.schemas.lidar import Sweep
from camber.schemas.pose import IndependentPosition, Pose, Road
from support.small_map import at
from support.street_drive import StreetDrive, east_north
from unit.localizer.test_localizer_service import GIVEN, Drive, arbitrary_fix, fix_at, verdict_at


def independent_bytes(poses: list[Pose]) -> list[bytes]:
    """The independent positions alone, each in an otherwise empty pose."""
    road = Road(status="unknown")
    empty = Pose(time_ns=poses[0].time_ns, mode="none", provenance="none", road=road)
    return [encode(empty.model_copy(update={"independent": pose.independent})) for pose in poses]


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(["right", "led away", "arbitrary"]))
def test_other_fixes_and_verdicts_give_the_same_bytes(seed: int, kind: str) -> None:
    random = Random(seed)
    kept, others = [], []
    for disturbed in (False, True):
        # Arbitrary fixes have arbitrary heights, which the relief would use.
        drive = Drive(initial_pose=GIVEN, use_relief=kind != "arbitrary")
        for k in range(250):
            tenth, messages = drive.tenth + 1, list[Fix | Verdict]()
            if kind != "arbitrary" and not disturbed:
                messages = [fix_at(tenth, tenth * 1.0)]  # of the same height
            if disturbed:
                away_m = {"right": 0.0, "led away": 0.02 * k, "arbitrary": random.gauss(0.0, 3.0)}[kind]
                messages = [
                    arbitrary_fix(random, tenth)
                    if kind == "arbitrary"
                    else fix_at(tenth, tenth * 1.0, away_m),
                    verdict_at(tenth, "confirmed", tenth * 1.0, away_m),
                ]
            drive.step(*messages)
        kept.append(independent_bytes(drive.bus.poses))
        others.append([pose.latitude_rad for pose in drive.bus.poses])
    assert len(kept[0]) == 250
    assert kept[0] == kept[1]
    assert others[0] != others[1], "the verdicts have moved the pose, so the test can fail"


def test_without_evidence_there_is_none_however_many_fixes_are_confirmed() -> None:
    drive = Drive()
    drive.start_by_fixes(20)
    for _ in range(50):
        tenth = drive.tenth + 1
        pose = drive.step(verdict_at(tenth, "confirmed", tenth * 1.0))
    assert pose is not None
    assert (pose.mode, pose.horizontal_basis) == ("anchored", "fixes")
    assert pose.independent is None


def test_its_covariance_grows_with_the_distance_while_the_anchored_pose_stays_precise() -> None:
    drive = Drive(initial_pose=GIVEN)
    sigmas = []
    for _ in range(600):
        tenth = drive.tenth + 1
        pose = drive.step(verdict_at(tenth, "confirmed", tenth * 1.0))
        assert pose is not None
        assert pose.independent is not None
        sigmas.append(math.sqrt(pose.independent.covariance_east_north[0]))
        assert pose.independent.basis == "given"
    assert pose.independent.distance_m > 500.0
    assert sigmas[-1] > sigmas[0] + 1.0
    assert pose.covariance_east_north_yaw is not None
    assert math.sqrt(pose.covariance_east_north_yaw[0]) < 0.1
    here = at(drive.east_m, 0.0)
    off_m = (pose.independent.longitude_rad - here[1]) * 6.37e6 * math.cos(here[0])
    assert abs(off_m) < 3.0 * sigmas[-1]


# With a LiDAR


def verdict(drive: StreetDrive, off_m: tuple[float, float]) -> Verdict:
    """A confirmed position so far east and north of the vehicle."""
    fix = drive.fix(drive.at_m(drive.time_ns) + off_m[0], off_m[1])
    fields = {name: getattr(fix, name) for name in ("latitude_rad", "longitude_rad", "covariance_enu_m2")}
    return Verdict(time_ns=fix.time_ns, fix_id=fix.fix_id, verdict="confirmed", reason="none", **fields)


def anchored(
    drive: StreetDrive,
    tenths: int,
    *,
    off_m: tuple[float, float] = (0.0, 0.0),
    away_m_s: float = 0.0,
    sweeps: Callable[[Sweep], list[Sweep]] | None = None,
) -> None:
    """Confirmed positions that are off by a vector, and are led away by so much a second."""
    for k in range(tenths):
        led_m = 0.1 * away_m_s * k
        drive.localization.on_verdict(verdict(drive, (off_m[0] + led_m, off_m[1] - 0.5 * led_m)))
        drive.run(1, sweeps=sweeps)


def off_m(drive: StreetDrive, position: IndependentPosition | None, time_ns: int) -> float:
    assert position is not None
    east_m, north_m = east_north(position.latitude_rad, position.longitude_rad)
    return math.hypot(east_m - drive.at_m(time_ns), north_m)


def no_returns(sweep: Sweep) -> list[Sweep]:
    return [sweep.model_copy(update={"points_m": np.full_like(sweep.points_m, np.nan)})]


def test_with_a_lidar_other_verdicts_give_the_same_bytes() -> None:
    runs, poses = [], []
    for away_m_s in (None, 0.0, 2.0):
        drive = StreetDrive()
        if away_m_s is None:
            drive.run(40)
        else:
            anchored(drive, 40, away_m_s=away_m_s)
        runs.append(independent_bytes(drive.poses))
        poses.append([pose.latitude_rad for pose in drive.poses])
        last = drive.poses[-1]
        assert last.independent is not None
        assert last.independent.basis == "scan_match"
        assert off_m(drive, last.independent, last.time_ns) < 0.06
    assert runs[0] == runs[1] == runs[2]
    assert poses[0] != poses[2], "the verdicts have moved the pose, so the test can fail"


def test_sweeps_that_never_match_count_for_nothing() -> None:
    """The same bytes as without any sweep, while verdicts lead the pose away."""
    blind, none = StreetDrive(), StreetDrive()
    anchored(blind, 60, away_m_s=0.5, sweeps=no_returns)
    anchored(none, 60, away_m_s=0.5, sweeps=lambda sweep: [])
    assert {match.status for match in blind.matches} == {"lost"}
    assert independent_bytes(blind.poses) == independent_bytes(none.poses)
    last = blind.poses[-1].independent
    assert last is not None
    assert (last.basis, last.evidence_time_ns) == ("given", blind.poses[0].time_ns)


def test_without_a_given_pose_it_starts_where_unique_matches_agree() -> None:
    drive = StreetDrive(given=False, begin_m=-40.0)
    drive.run(25, fixes=lambda d: d.fix(d.at_m(d.time_ns), 0.0), sweeps=lambda sweep: [])
    assert all(pose.independent is None for pose in drive.poses)
    anchored(drive, 90)
    last = drive.poses[-1]
    assert last.independent is not None
    assert last.independent.basis == "scan_match"
    assert off_m(drive, last.independent, last.time_ns) < 0.1


def test_it_starts_at_the_vehicle_where_wrong_fixes_have_anchored_the_pose() -> None:
    """A confirmed base coordinate error of 1.5 m: the search finds the vehicle, and not the pose."""
    drive = StreetDrive(given=False, begin_m=-40.0)
    drive.run(25, fixes=lambda d: d.fix(d.at_m(d.time_ns) + 1.3, 0.8), sweeps=lambda sweep: [])
    anchored(drive, 100, off_m=(1.3, 0.8))
    last = drive.poses[-1]
    assert last.independent is not None
    assert off_m(drive, last.independent, last.time_ns) < 0.1


def test_its_place_is_that_of_the_antenna_in_the_message() -> None:
    drive = StreetDrive()
    drive.run(3)
    pose = drive.poses[0]
    assert pose.independent is not None
    assert pose.latitude_rad is not None
    assert abs(pose.independent.latitude_rad - pose.latitude_rad) * 6.4e6 < 1e-3
