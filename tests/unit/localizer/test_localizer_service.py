"""The localizer's process: no unconfirmed fix in the pose, and a reason wherever the road is not known."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any, cast, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.localizer.service import LocalizerService
from camber.localizer.settings import LocalizerSettings
from camber.localizer.warm_up import SyntheticMap
from camber.runtime.bus import Bus, QueryFailed
from camber.schemas.codec import encode
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict, VerdictValue
from camber.schemas.motion import Imu, Motion
from camber.schemas.pose import Pose, Road, ScanMatch
from camber.schemas.road import ElevationReply, ElevationRequest, LinksReply, LinksRequest, Places, RoadsAhead
from support.fake_bus import FakeBus
from support.small_map import at

NS = 1_000_000_000
START_NS = 1_300_000_000 * NS
SPEED = 10.0
STEP_S = 0.1
SMALL = (4e-4, 0.0, 0.0, 4e-4, 0.0, 1e-3)
GIVEN = {
    "latitude_deg": math.degrees(at(0.0, 0.0)[0]),
    "longitude_deg": math.degrees(at(0.0, 0.0)[1]),
    "yaw_deg": 0.0,
    "horizontal_sigma_m": 0.5,
    "yaw_sigma_deg": 1.0,
}
VERDICTS_WITHOUT_TRUST = set(get_args(VerdictValue)) - {"confirmed", "confirmed_after_verification"}
NOT_FIXED = ["float", "dgps", "single", "ppp", "sbas", "estimated", "none"]


def flat(places: Places) -> RoadsAhead:
    n = len(places.east_m)
    return RoadsAhead(
        place=np.arange(n, dtype=np.int32),
        surface_id=np.ones(n, np.int64),
        level=np.zeros(n, np.int32),
        elevation_m=np.full(n, 50.0),
        sigma_m=np.full(n, 0.02),
        slope_east=np.zeros(n),
        slope_north=np.zeros(n),
        extent_m=np.full(n, 5.0),
    )


class FakeMap(SyntheticMap):
    """A straight road to the east, flat at 50 m, cut into links of 400 m; may be absent, slow, or have nothing."""

    def __init__(self) -> None:
        self.version = 1
        self.failure: str | None = None
        self.road: Road | None = None
        self.broken_link = False
        self.asked: list[ElevationRequest | LinksRequest] = []

    def ask(self, name: str, request: Any) -> Any:
        encode(request)
        self.asked.append(request)
        if self.failure is not None:
            raise QueryFailed(cast(Any, self.failure), "by the test")
        return self.elevation(request) if name == "elevation" else self.links(request)

    def elevation(self, request: ElevationRequest) -> ElevationReply:
        road = self.road or super().elevation(request).road.model_copy(update={"map_version": self.version})
        return ElevationReply(
            time_ns=request.time_ns, road=road, ahead=None if request.ahead is None else flat(request.ahead)
        )

    def links(self, request: LinksRequest) -> LinksReply:
        nodes = range(-4, 26)
        points = [
            at(400.0 * n + 400.0 * step * (not self.broken_link), 0.0) for n in nodes for step in (0, 1)
        ]
        count = len(nodes)
        return LinksReply(
            time_ns=request.time_ns,
            status="known",
            map_version=self.version,
            link_id=np.arange(count, dtype=np.int64) + 100,
            start_node=np.arange(count, dtype=np.int64),
            end_node=np.arange(count, dtype=np.int64) + 1,
            level=np.zeros(count, dtype=np.int32),
            sigma_m=np.full(count, 0.5),
            first_vertex=np.arange(0, 2 * count + 2, 2, dtype=np.int32),
            latitude_rad=np.array([point[0] for point in points]),
            longitude_rad=np.array([point[1] for point in points]),
        )

    def count(self, kind: type) -> int:
        return sum(isinstance(request, kind) for request in self.asked)

    def last_elevation(self) -> ElevationRequest:
        return [request for request in self.asked if isinstance(request, ElevationRequest)][-1]


class PoseBus(FakeBus):
    def __init__(self, map_server: FakeMap) -> None:
        super().__init__()
        self.map = map_server
        self.poses: list[Pose] = []

    def ask(self, name: str, request: Any) -> Any:
        return self.map.ask(name, request)

    def is_alive(self, service: str) -> bool:
        assert service == "map_server"
        return self.map.failure != "absent"

    def publish(self, name: str, message: Pose) -> None:
        assert name == "pose"
        self.poses.append(message)


def position_at(tenth: int, east_m: float, north_m: float) -> dict[str, Any]:
    latitude, longitude = at(east_m, north_m)
    position = {"latitude_rad": latitude, "longitude_rad": longitude, "height_m": 52.0}
    return {"time_ns": START_NS + tenth * NS // 10, "fix_id": tenth, "covariance_enu_m2": SMALL} | position


def fix_at(tenth: int, east_m: float, north_m: float = 0.0, **changed: Any) -> Fix:
    return Fix(**{"origin": "receiver", "quality": "fixed"} | position_at(tenth, east_m, north_m) | changed)


def verdict_at(tenth: int, value: Any, east_m: float, north_m: float = 0.0, **changed: Any) -> Verdict:
    return Verdict(**{"verdict": value, "reason": "none"} | position_at(tenth, east_m, north_m) | changed)


class Drive:
    """A vehicle that drives east at 10 m/s from the origin, ten samples a second."""

    def __init__(self, **settings_: Any) -> None:
        self.map = FakeMap()
        self.bus = PoseBus(self.map)
        settings = LocalizerSettings(**{"clock": "replay"} | settings_)
        self.service = LocalizerService(settings, cast(Bus, self.bus))
        self.handlers: dict[str, Callable[[Any], None]] = self.service.handlers()
        self.tenth = -1
        self.speed_m_s = SPEED
        self.east_m = 0.0

    def step(self, *others: Fix | Verdict) -> Pose | None:
        """One tick: the motion sample, then fixes and verdicts, then the pose of this tick."""
        self.tenth += 1
        now_ns = START_NS + self.tenth * NS // 10
        if self.tenth:
            self.east_m += self.speed_m_s * STEP_S
        before = len(self.bus.poses)
        self.handlers["motion"](Motion(time_ns=now_ns, wheel_speed_m_s=self.speed_m_s, yaw_rate_rad_s=0.0))
        for message in others:
            self.handlers["fix" if isinstance(message, Fix) else "verdict"](message)
        self.service.advance(now_ns)
        assert len(self.bus.poses) - before <= 1
        return self.bus.poses[-1] if len(self.bus.poses) > before else None

    def run(self, steps: int) -> Pose:
        for _ in range(steps):
            pose = self.step()
        assert pose is not None
        return pose

    def start_by_fixes(self, steps: int = 25) -> Pose:
        for _ in range(steps):
            tenth = self.tenth + 1
            pose = self.step(fix_at(tenth, tenth * SPEED * STEP_S))
        assert pose is not None
        return pose

    def off_m(self, pose: Pose) -> float:
        """How far the pose is from where the vehicle is."""
        here = at(self.east_m, 0.0)
        assert pose.latitude_rad is not None
        assert pose.longitude_rad is not None
        return math.hypot(
            (pose.latitude_rad - here[0]) * 6.36e6,
            (pose.longitude_rad - here[1]) * 6.37e6 * math.cos(here[0]),
        )

    def codes(self) -> Counter[str]:
        return Counter(code for code, _ in self.bus.issues)


def bytes_of(poses: Iterable[Pose]) -> list[bytes]:
    return [encode(pose) for pose in poses]


def without_fixes(poses: Iterable[Pose]) -> list[Pose]:
    """The poses alone: the independent position uses the heights of fixes, and a run is one of fixes."""
    return [pose.model_copy(update={"independent": None, "fix_run_begin_time_ns": None}) for pose in poses]


def test_without_a_start_there_is_no_pose_and_the_reason_is_reported() -> None:
    drive = Drive()
    pose = drive.run(5)
    assert (pose.mode, pose.provenance) == ("none", "none")
    assert (pose.latitude_rad, pose.covariance_east_north_yaw) == (None, None)
    assert pose.reason
    assert (pose.road.status, pose.road.reason) == ("unknown", "no_pose")
    assert drive.map.asked == []
    assert not drive.service.healthy()


def test_fixes_that_agree_with_the_motion_start_a_provisional_pose() -> None:
    drive = Drive()
    pose = drive.start_by_fixes()
    assert (pose.mode, pose.provenance, pose.anchor_time_ns) == ("provisional", "fixes", None)
    assert drive.off_m(pose) < 0.5
    assert pose.yaw_rad == pytest.approx(0.0, abs=0.02)
    assert pose.road.status == "known"
    assert drive.service.healthy()
    assert drive.start_by_fixes(200).mode == "provisional", "however many fixes agree"


@pytest.mark.parametrize(
    ("speed_m_s", "changed", "codes"),
    [
        (12.0, {}, set()),  # does not follow the motion
        *((10.0, {"quality": name}, set()) for name in NOT_FIXED),
        (10.0, {"covariance_enu_m2": None}, set()),
        (10.0, {"covariance_enu_m2": (0.0,) * 6}, {"unusable_covariance"}),
        (10.0, {"covariance_enu_m2": (1.0, 2.0, 0.0, 1.0, 0.0, 1.0)}, {"unusable_covariance"}),
    ],
)
def test_only_fixes_of_quality_fixed_with_a_covariance_that_follow_the_motion_start_anything(
    speed_m_s: float, changed: dict[str, Any], codes: set[str]
) -> None:
    drive = Drive()
    for tenth in range(60):
        pose = drive.step(fix_at(tenth, tenth * speed_m_s * STEP_S, **changed))
    assert pose.mode == "none"
    assert drive.bus.codes() == codes


@pytest.mark.parametrize(("latitude", "longitude"), [(0.0, 0.0), (-0.61, -0.752), (1.2, 2.3)])
def test_a_first_fix_anywhere_on_earth_does_not_prevent_the_start(latitude: float, longitude: float) -> None:
    drive = Drive()
    drive.step(fix_at(0, 0.0, latitude_rad=latitude, longitude_rad=longitude))
    pose = drive.start_by_fixes(30)
    assert pose.mode == "provisional"
    assert drive.off_m(pose) < 0.5


def test_a_given_pose_starts_at_once_and_is_not_provisional() -> None:
    drive = Drive(initial_pose=GIVEN)
    pose = drive.step()
    assert (pose.mode, pose.provenance) == ("dead_reckoning", "given")
    assert drive.off_m(pose) < 0.01
    covariance = pose.covariance_east_north_yaw
    assert math.sqrt(covariance[0]) == pytest.approx(0.5, rel=0.01)
    assert math.sqrt(covariance[5]) == pytest.approx(math.radians(1.0), rel=0.01)


def test_a_given_pose_is_that_of_the_antenna() -> None:
    drive = Drive(initial_pose=GIVEN | {"yaw_deg": 90.0}, antenna_x_m=1.5, antenna_y_m=-0.5)
    pose = drive.step()
    assert pose is not None
    assert drive.off_m(pose) < 0.01


def test_a_wild_fix_before_a_given_pose_moves_nothing() -> None:
    plain, disturbed = Drive(initial_pose=GIVEN), Drive(initial_pose=GIVEN)
    disturbed.handlers["fix"](fix_at(0, 0.0, latitude_rad=-0.2, longitude_rad=0.4))
    for drive in (plain, disturbed):
        drive.run(100)
    assert bytes_of(plain.bus.poses) == bytes_of(disturbed.bus.poses)


@pytest.mark.parametrize("value", ["confirmed", "confirmed_after_verification"])
def test_a_confirmed_position_anchors_the_pose(value: str) -> None:
    drive = Drive(initial_pose=GIVEN)
    drive.run(20)
    anchor = verdict_at(drive.tenth, value, drive.east_m)
    pose = drive.step(anchor)
    assert (pose.mode, pose.provenance, pose.anchor_time_ns) == ("anchored", "confirmed", anchor.time_ns)
    covariance = pose.covariance_east_north_yaw
    assert math.sqrt(covariance[0]) < 0.2
    assert drive.bus.counters["anchor.accepted"] == 1


@pytest.mark.parametrize("value", sorted(VERDICTS_WITHOUT_TRUST))
def test_no_other_verdict_ever_anchors(value: str) -> None:
    plain, disturbed = Drive(initial_pose=GIVEN), Drive(initial_pose=GIVEN)
    for tenth in range(60):
        plain.step()
        disturbed.step(verdict_at(tenth, value, tenth + 3.0))
    assert bytes_of(plain.bus.poses) == bytes_of(disturbed.bus.poses)
    assert not any(name.startswith("anchor") for name in disturbed.bus.counters)


@pytest.mark.parametrize(
    ("name", "value", "issues"),
    [
        ("latitude_rad", None, {}),
        ("longitude_rad", None, {}),
        ("covariance_enu_m2", None, {}),
        ("covariance_enu_m2", (0.0,) * 6, {"unusable_covariance": 1}),
    ],
)
def test_a_confirmation_without_a_whole_position_anchors_nothing(
    name: str, value: Any, issues: dict[str, int]
) -> None:
    drive = Drive(initial_pose=GIVEN)
    drive.run(10)
    pose = drive.step(verdict_at(drive.tenth, "confirmed", drive.east_m, **{name: value}))
    assert pose.provenance == "given"
    assert drive.codes() == issues


def arbitrary_fix(random: Random, tenth: int) -> Fix:
    far = random.random() < 0.3
    position = (
        {"latitude_rad": random.uniform(-1.5, 1.5), "longitude_rad": random.uniform(-3.1, 3.1)} if far else {}
    )
    sigma2 = 10.0 ** random.uniform(-8, 2)
    return fix_at(
        tenth,
        tenth * 1.0 + random.gauss(0.0, 5.0),
        random.gauss(0.0, 5.0),
        quality=random.choice(["fixed", "fixed", "float", "single"]),
        covariance_enu_m2=random.choice([(sigma2, 0.0, 0.0, sigma2, 0.0, sigma2), None]),
        height_m=random.uniform(-100.0, 3000.0),
        fix_id=random.randrange(10**9),
        **position,
    )


def wandering_fix(tenth: int) -> Fix:
    """What would start a pose anywhere else: fixes that agree with the motion, twelve metres beside it."""
    return fix_at(tenth, tenth * 1.0 - 5.0, 12.0)


def test_a_pose_has_since_when_the_fixes_have_not_stepped() -> None:
    drive = Drive(initial_pose=GIVEN)
    assert drive.step().fix_run_begin_time_ns is None
    begins = []
    for _ in range(40):
        tenth = drive.tenth + 1
        pose = drive.step(fix_at(tenth, tenth * SPEED * STEP_S, 1.5 if tenth >= 20 else 0.0))
        assert pose.fix_run_begin_time_ns is not None
        begins.append((pose.fix_run_begin_time_ns - START_NS) * 10 // NS)
    assert begins == [1] * 19 + [20] * 21


@pytest.mark.parametrize("start", ["given", "confirmed", "given and confirmed"])
@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(["arbitrary", "wandering", "many"]))
def test_no_unconfirmed_fix_changes_a_single_bit_of_a_pose_that_was_given_or_anchored(
    start: str, seed: int, kind: str
) -> None:
    random = Random(seed)
    poses = []
    for disturbed in (False, True):
        drive = Drive(**({"initial_pose": GIVEN} if "given" in start else {}))
        if start == "confirmed":
            drive.start_by_fixes(20)
            drive.step(verdict_at(drive.tenth, "confirmed", drive.east_m))
        begun = len(drive.bus.poses)
        for _ in range(60):
            tenth = drive.tenth + 1
            others: list[Fix | Verdict] = []
            if disturbed:
                if kind == "wandering":
                    others = [wandering_fix(tenth)]
                else:
                    others = [arbitrary_fix(random, tenth) for _ in range(3 if kind == "many" else 1)]
            if "confirmed" in start and tenth % 25 == 24:
                others.insert(len(others) // 2, verdict_at(tenth - 1, "confirmed", (tenth - 1) * 1.0, 0.01))
            drive.step(*others)
        poses.append(bytes_of(without_fixes(drive.bus.poses[begun:])))
    assert len(poses[0]) >= 60
    assert poses[0] == poses[1]


def test_a_fix_does_change_a_provisional_pose_so_the_test_above_can_fail() -> None:
    plain, disturbed = Drive(), Drive()
    for drive in (plain, disturbed):
        drive.start_by_fixes(20)
    for _ in range(30):
        plain.step()
        disturbed.step(wandering_fix(disturbed.tenth + 1))
    assert bytes_of(plain.bus.poses[-5:]) != bytes_of(disturbed.bus.poses[-5:])


@pytest.mark.parametrize(
    ("failure", "reason"),
    [
        ("absent", "map_server_absent"),
        ("timeout", "map_server_absent"),
        ("refused", "map_missing"),
        ("invalid", "map_missing"),
    ],
)
def test_without_an_answer_the_road_is_unknown_and_the_reason_is_reported(failure: str, reason: str) -> None:
    drive = Drive(initial_pose=GIVEN)
    assert drive.run(5).road.status == "known"
    drive.map.failure = failure
    pose = drive.run(5)
    assert pose.mode == "dead_reckoning"
    assert (pose.road.status, pose.road.reason, pose.road.elevation_m) == ("unknown", reason, None)
    assert drive.codes()["no_elevation"] == 5
    drive.map.failure = None
    assert drive.run(1).road.status == "known"
    assert drive.map.last_elevation().last_surface_id is None, "no old surface is named"


def test_an_unknown_road_of_the_map_is_passed_on() -> None:
    drive = Drive(initial_pose=GIVEN)
    drive.map.road = Road(status="unknown", reason="levels_ambiguous")
    assert drive.run(3).road == drive.map.road


def test_the_road_is_asked_for_under_the_antenna_with_links_and_the_last_surface() -> None:
    drive = Drive(initial_pose=GIVEN, antenna_x_m=1.5)
    pose = drive.run(100)
    request = drive.map.last_elevation()
    assert (request.latitude_rad, request.longitude_rad) == (pose.latitude_rad, pose.longitude_rad)
    assert request.last_surface_id == 1
    assert pose.link_id == 104
    assert 104 in request.link_ids


def test_an_uncertain_pose_gets_the_road_around_it_and_a_certain_one_does_not() -> None:
    drive = Drive(initial_pose=GIVEN, couple_links=False)
    drive.run(1)
    assert drive.map.last_elevation().radius_m == pytest.approx(3.7 * 0.5, rel=0.05)
    for _ in range(3):
        drive.step(verdict_at(drive.tenth, "confirmed", drive.east_m))
    assert drive.map.last_elevation().radius_m == 0.0


def certain(speed_m_s: float = 10.0) -> Drive:
    """A vehicle that knows where it is, and so asks for the road ahead too."""
    drive = Drive(initial_pose=GIVEN | {"horizontal_sigma_m": 0.1, "yaw_sigma_deg": 0.1}, couple_links=False)
    drive.speed_m_s = speed_m_s
    drive.run(1)
    return drive


@pytest.mark.parametrize("speed_m_s", [0.0, 10.0])
def test_a_certain_pose_asks_for_its_road_every_two_seconds(speed_m_s: float) -> None:
    drive = certain(speed_m_s)
    for step in range(100):
        pose = drive.step(verdict_at(drive.tenth, "confirmed", drive.east_m))
        assert pose.road.status == "known", step
    assert 100 / 25 <= drive.map.count(ElevationRequest) <= 100 / 12


def test_standing_a_change_of_the_road_is_seen_within_two_seconds_and_a_lost_map_server_at_once() -> None:
    drive = certain(0.0)
    drive.run(10)
    drive.map.road = Road(status="unknown", reason="map_stale")
    assert drive.run(21).road.reason == "map_stale"
    drive.map.road = None
    assert drive.run(10).road.status == "known"
    drive.map.failure = "absent"
    assert drive.run(1).road.reason == "map_server_absent"


def test_a_pose_that_has_become_certain_gets_its_road_at_once() -> None:
    drive = Drive(initial_pose=GIVEN | {"horizontal_sigma_m": 16.0}, couple_links=False)
    drive.speed_m_s = 0.0
    assert drive.run(1).road.reason == "pose_too_uncertain"
    assert drive.map.count(ElevationRequest) == 0
    drive.step(verdict_at(drive.tenth, "confirmed", drive.east_m))
    assert drive.run(1).road.status == "known"


def test_links_are_fetched_once_and_again_where_the_vehicle_has_driven_on() -> None:
    drive = Drive(initial_pose=GIVEN, links_radius_m=200.0)
    drive.run(70)
    assert drive.map.count(LinksRequest) == 1
    drive.run(30)
    assert drive.map.count(LinksRequest) == 2


def test_links_are_fetched_again_when_the_map_has_changed() -> None:
    drive = Drive(initial_pose=GIVEN)
    drive.run(20)
    drive.map.version = 2
    drive.run(5)
    assert drive.map.count(LinksRequest) == 2
    drive.run(40)
    assert drive.map.count(LinksRequest) == 2


@pytest.mark.parametrize("failure", ["absent", "timeout"])
def test_failed_link_queries_are_repeated_once_a_second(failure: str) -> None:
    drive = Drive(initial_pose=GIVEN)
    drive.map.failure = failure
    pose = drive.run(41)
    assert pose.link_id is None
    assert drive.codes()["no_links"] == drive.map.count(LinksRequest)
    assert 4 <= drive.map.count(LinksRequest) <= 5
    drive.map.failure = None
    assert drive.run(60).link_id is not None


def test_degenerate_links_are_an_issue_and_not_a_failure() -> None:
    drive = Drive(initial_pose=GIVEN)
    drive.map.broken_link = True
    pose = drive.run(20)
    assert pose.mode == "dead_reckoning"
    assert pose.link_id is None
    assert drive.codes()["unusable_links"] >= 1


def test_the_plane_moves_with_the_vehicle_and_the_pose_does_not_jump() -> None:
    drive = Drive(initial_pose=GIVEN | {"horizontal_sigma_m": 0.05, "yaw_sigma_deg": 0.05})
    previous = drive.run(1)
    farthest = 0.0
    planes = set()
    for _ in range(2300):  # 2.3 km
        pose = drive.step()
        assert pose.longitude_rad is not None
        assert previous.longitude_rad is not None
        step_m = (pose.longitude_rad - previous.longitude_rad) * 6.37e6 * math.cos(at(0.0, 0.0)[0])
        farthest = max(farthest, abs(step_m - SPEED * STEP_S))
        previous = pose
        planes.add(id(drive.service._localization._plane))
    assert len(planes) >= 2
    assert farthest < 0.2  # a coupling with a link may move it a little
    assert previous.link_id >= 109


def test_one_pose_per_motion_sample() -> None:
    drive = Drive(initial_pose=GIVEN)
    drive.run(10)
    drive.service.advance(START_NS + drive.tenth * NS // 10 + NS // 20)
    assert len(drive.bus.poses) == 10
    assert [pose.time_ns for pose in drive.bus.poses] == [START_NS + n * NS // 10 for n in range(10)]
    assert all(pose.motion_time_ns == pose.time_ns for pose in drive.bus.poses)


def test_a_given_pose_is_believed_once_and_not_at_the_next_start(tmp_path: Path) -> None:
    given: dict[str, Any] = {"initial_pose": GIVEN, "state_dir": tmp_path, "clock": "system"}
    assert Drive(**given).run(1).mode != "none"
    again = Drive(**given)
    assert again.run(1).mode == "none"
    assert again.codes() == {}
    elsewhere = Drive(**given | {"initial_pose": GIVEN | {"yaw_deg": 1.0}})
    assert elsewhere.run(1).mode != "none"


def test_a_given_pose_counts_as_used_where_the_note_of_it_is_damaged(tmp_path: Path) -> None:
    given: dict[str, Any] = {"initial_pose": GIVEN, "state_dir": tmp_path, "clock": "system"}
    (tmp_path / "given_pose.json").write_bytes(b"{")
    first = Drive(**given)
    assert first.run(1).mode == "none"
    assert first.codes() == {"state_rejected": 1}
    again = Drive(**given)
    assert again.run(1).mode == "none"
    assert again.codes() == {}


def test_a_given_pose_that_nothing_can_keep_from_being_believed_again_is_an_issue() -> None:
    drive = Drive(initial_pose=GIVEN, clock="system")
    drive.run(5)
    assert drive.codes() == {"given_pose_not_kept": 1}


def test_motion_that_goes_back_in_time_is_an_issue_and_moves_nothing() -> None:
    drive = Drive(initial_pose=GIVEN)
    pose = drive.run(10)
    drive.handlers["motion"](Motion(time_ns=START_NS, wheel_speed_m_s=30.0, yaw_rate_rad_s=1.0))
    drive.handlers["motion"](Motion(time_ns=pose.time_ns, wheel_speed_m_s=30.0, yaw_rate_rad_s=1.0))
    drive.service.advance(pose.time_ns)
    assert drive.bus.poses[-1] is pose
    assert drive.codes() == {"motion_backwards": 1, "motion_repeated": 1}


def test_an_inertial_unit_drives_the_pose_and_its_old_samples_are_issues() -> None:
    drive = Drive(initial_pose=GIVEN, imu_class="mems", couple_links=False)
    for n in range(1, 501):
        time_ns = START_NS + n * NS // 100
        drive.handlers["imu"](unit_at_rest(time_ns, turning_rad_s=0.1))
        if n % 10 == 0:
            drive.handlers["motion"](Motion(time_ns=time_ns, wheel_speed_m_s=SPEED, yaw_rate_rad_s=-1.0))
            drive.service.advance(time_ns)
    pose = drive.bus.poses[-1]
    assert 0 <= START_NS + 5 * NS - pose.time_ns < NS // 50
    assert pose.yaw_rate_rad_s == pytest.approx(0.1, abs=0.01)
    assert pose.yaw_rad == pytest.approx(0.44, abs=0.05)  # levelled after half a second
    assert pose.speed_m_s == pytest.approx(SPEED, abs=0.1)
    drive.handlers["imu"](unit_at_rest(START_NS + 5 * NS))
    drive.handlers["imu"](unit_at_rest(START_NS))
    assert drive.codes() == {"imu_repeated": 1, "imu_backwards": 1}


def test_without_imu_class_an_inertial_unit_is_left_alone() -> None:
    drive = Drive(initial_pose=GIVEN)
    drive.handlers["imu"](unit_at_rest(START_NS))
    drive.service.advance(START_NS)
    assert drive.bus.poses == []


def unit_at_rest(time_ns: int, turning_rad_s: float = 0.0) -> Imu:
    return Imu(
        time_ns=time_ns,
        angular_rate_rad_s=(0.0, 0.0, turning_rad_s),
        specific_force_m_s2=(0.0, SPEED * turning_rad_s, 9.80665),
    )


def test_inputs_are_motion_imu_fix_verdict_and_sweep() -> None:
    assert set(Drive().handlers) == {"motion", "imu", "fix", "verdict", "sweep"}


def test_points_of_matches_are_published_once_a_second_and_only_while_somebody_subscribes() -> None:
    drive, published = Drive(), list[int]()
    bus: Any = drive.bus
    matcher: Any = SimpleNamespace(last_points=lambda: SimpleNamespace(time_ns=now_ns))
    drive.service._localization.matcher = matcher
    bus.publish = lambda name, message: published.append((message.time_ns - START_NS) // (NS // 10))
    for bus.has_subscriber in (lambda _: False, lambda name: name == "scan_match_points"):
        for tenth in range(25):
            now_ns = START_NS + tenth * NS // 10
            status: Any = "lost" if tenth == 10 else "converged"
            drive.service._publish_match_points(ScanMatch(time_ns=now_ns, status=status))
    assert published == [0, 11, 21]
