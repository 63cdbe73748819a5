"""The judge says *confirmed* only where everything is known, fresh and in agreement; each way out has its reason."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from camber.integrity.checks.consistency_tests import ConsistencyParameters
from camber.integrity.learning.height_correction import Correction, Learning, LearningRules
from camber.integrity.learning.offset_causes import Diagnosis
from camber.integrity.learning.residuals import ReferenceKey
from camber.integrity.rules import Rules
from camber.schemas.gnss import ReceiverIntegrity
from support.judging import ALL, ROAD_M, SettlingJudge, antenna, at, fix, independent, pose, provisional, road

BY_GAIN = Rules(learning=LearningRules(mode="document"))


class Knowing(Learning):
    """A learning that knows a cause, or a correction, from the beginning."""

    def __init__(self, cause="none", correction=None):
        super().__init__(LearningRules())
        self._cause, self._known = cause, correction or Correction()

    def diagnosis(self, surface_id):
        return Diagnosis(cause=self._cause)

    def correction(self, key):
        return self._known


def judge_with(*, poses=(), antenna_height=None, learning=None, rules=None):
    judge = SettlingJudge(rules or Rules(), learning)
    for one in poses:
        judge.latest.add_pose(one)
    if antenna_height is not None:
        judge.latest.set_antenna_height(antenna_height)
    return judge


def judged(the_fix=None, *, now=0.0, alive=ALL, the_pose=None, the_antenna=None, statement=None, **others):
    """The judgement of one fix, with everything there and right but for what is given."""
    poses = [the_pose if the_pose is not None else pose()]
    judge = judge_with(poses=poses, antenna_height=the_antenna or antenna(), **others)
    judge.latest.receiver.update(ReceiverIntegrity(time_ns=at(0), **statement or {}))
    judgement = judge.judge(the_fix or fix(), at(now), alive)
    assert judgement is not None
    return judgement


def verdict_and_reason(judgement):
    return judgement.verdict, judgement.reason


class Drive:
    """A judge along a drive: each epoch a pose and a fix."""

    def __init__(self, *, rules=None, speed_m_s=10.0):
        self.judge = SettlingJudge(rules or Rules())
        self.speed_m_s = speed_m_s

    def epoch(self, k, the_fix=None, the_pose=None):
        self.judge.latest.add_pose(the_pose or pose(k))
        self.judge.latest.set_antenna_height(antenna(k))
        self.judge.latest.add_wheel_speed(at(k), self.speed_m_s)
        judgement = self.judge.judge(the_fix or fix(k), at(k), ALL)
        assert judgement is not None
        return judgement


# --- one fix -----------------------------------------------------------------------------------------------------


def test_a_fix_on_road_and_antenna_near_the_pose_is_confirmed():
    judgement = judged()
    assert judgement.confirmed
    assert verdict_and_reason(judgement) == ("confirmed", "height_agrees")
    assert judgement.evidence == ("height", "consistency")
    assert judgement.road.surface_id == 7


def test_a_fix_off_the_height_is_erroneous():
    judgement = judged(fix(up_m=0.5))
    assert not judgement.confirmed
    assert verdict_and_reason(judgement) == ("erroneous", "height_disagrees")
    assert judgement.comparison.height_m == pytest.approx(-0.5)
    assert "height -0.50 m" in judgement.detail


def no_road():
    return road(status="unknown", reason="no_surface")


REJECTIONS = [
    ("fix_implausible", {"the_fix": fix(3), "now": 0.0}),
    ("gnss_stale", {"now": 2.6}),
    ("not_a_fix", {"the_fix": fix(quality="float")}),
    ("fix_implausible", {"the_fix": fix(covariance_enu_m2=None)}),
    ("fix_implausible", {"the_fix": fix(covariance_enu_m2=(0.3, 0.0, 0.0, 0.3, 0.0, 0.3))}),
    ("localizer_absent", {"the_pose": pose(-2), "alive": ALL - {"localizer"}}),
    ("pose_stale", {"the_pose": pose(-2)}),
    ("pose_stale", {"the_pose": pose(2)}),
    ("pose_missing", {"the_pose": pose(mode="none", provenance="none")}),
    ("pose_too_uncertain", {"the_pose": pose(sigma_m=20.0)}),
    ("antenna_height_absent", {"the_antenna": antenna(-11), "alive": ALL - {"antenna_height"}}),
    ("antenna_height_stale", {"the_antenna": antenna(-11)}),
    ("antenna_height_stale", {"the_antenna": antenna(11)}),
    ("antenna_height_disagrees", {"the_antenna": antenna(status="disagreement")}),
    ("antenna_height_missing", {"the_antenna": antenna(status="unknown")}),
    ("map_server_absent", {"the_pose": pose(road=road(status="unknown", reason="map_server_absent"))}),
    ("levels_ambiguous", {"the_pose": pose(road=road(status="unknown", reason="levels_ambiguous"))}),
    ("road_unknown", {"the_pose": pose(road=no_road())}),
    ("datum_mismatch", {"the_pose": pose(road=road(datum=None))}),
    ("datum_mismatch", {"the_fix": fix(datum="JGD2011")}),
    ("height_unverified", {"the_fix": fix(up_m=0.29)}),
    ("position_unverified", {"the_fix": fix(north_m=-0.5)}),
    ("receiver_warns", {"statement": {"spoofing": "affirmed"}}),
    ("pose_too_uncertain", {"the_fix": fix(east_m=21.0), "the_pose": pose(sigma_m=10.0)}),
    ("road_unknown", {"the_pose": pose(road=road(sigma_m=0.35))}),
    ("antenna_height_missing", {"the_antenna": antenna(sigma_m=0.35)}),
    ("starting", {"the_pose": provisional()}),
]


every_rejection = pytest.mark.parametrize(
    ("reason", "changes"), REJECTIONS, ids=[f"{i} {r}" for i, (r, _) in enumerate(REJECTIONS)]
)


@every_rejection
def test_every_row_of_the_rejection_table_is_unknown_with_its_reason(reason, changes):
    assert verdict_and_reason(judged(**changes)) == ("unknown", reason)


@every_rejection
def test_and_no_recent_right_fixes_turn_it_into_a_confirmed_one(reason, changes):
    drive = Drive()
    assert all(drive.epoch(k).confirmed for k in range(-5, 0))
    drive.judge.latest.set_antenna_height(changes.get("the_antenna") or antenna())
    drive.judge.latest.receiver.update(ReceiverIntegrity(time_ns=at(0), **changes.get("statement", {})))
    drive.judge.latest.poses.clear()  # the last known pose is the one given
    drive.judge.latest.add_pose(changes.get("the_pose") or pose())
    judgement = drive.judge.judge(
        changes.get("the_fix") or fix(), at(changes.get("now", 0.0)), changes.get("alive", ALL)
    )
    assert judgement.verdict == "unknown"


def test_without_any_pose_or_antenna_height_there_is_no_verdict():
    nothing = judge_with().judge(fix(), at(0), ALL)
    assert verdict_and_reason(nothing) == ("unknown", "pose_missing")
    no_antenna = judge_with(poses=[pose()]).judge(fix(), at(0), ALL)
    assert verdict_and_reason(no_antenna) == ("unknown", "antenna_height_missing")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    "where",
    ["height_m", "latitude_rad", "longitude_rad", "elevation_m", "slope_east", "antenna", "sigma_m", "pose"],
)
def test_what_is_not_a_number_is_never_confirmed(where, value):
    """Messages refuse such values; the judge does not rely on it."""
    the_fix, the_road, the_pose, the_antenna = fix(), road(), pose(), antenna()
    if where in ("height_m", "latitude_rad", "longitude_rad"):
        the_fix = the_fix.model_copy(update={where: value})
    elif where == "antenna":
        the_antenna = the_antenna.model_copy(update={"height_m": value})
    elif where == "pose":
        the_pose = the_pose.model_copy(
            update={"covariance_east_north_yaw": (value, 0.0, 0.0, value, 0.0, 0.0)}
        )
    else:
        the_road = the_road.model_copy(update={where: value})
    if where != "pose":
        the_pose = the_pose.model_copy(update={"road": the_road})
    drive = Drive()
    assert all(drive.epoch(k).confirmed for k in range(-5, 0))
    drive.judge.latest.set_antenna_height(the_antenna)
    drive.judge.latest.add_pose(the_pose)
    judgement = drive.judge.judge(the_fix, at(0), ALL)
    assert judgement.verdict == "unknown"


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_limits_of_the_position_are_those_of_the_rates_and_of_both_covariances(sign):
    sigma_m = math.sqrt(0.1**2 + (4 * 0.005) ** 2 + 0.05**2)
    agrees_m, contradicts_m = (sigma_m * math.sqrt(chi2.isf(rate / 2, 2)) for rate in (1e-3, 1e-6))
    rules = Rules(determination=ConsistencyParameters(tests=("height", "position")))

    def judged_at(north_m):
        return verdict_and_reason(judged(fix(north_m=sign * north_m), rules=rules))

    assert judged_at(agrees_m - 0.01) == ("confirmed", "height_agrees")
    assert judged_at(agrees_m + 0.01) == judged_at(contradicts_m - 0.01) == ("unknown", "position_unverified")
    assert judged_at(contradicts_m + 0.01) == ("erroneous", "position_disagrees")


def test_the_road_is_taken_where_the_fix_is_not_where_the_pose_is():
    steep = pose(sigma_m=2.0, road=road(slope_east=0.1))
    assert judged(fix(east_m=4.0, up_m=0.4), the_pose=steep).confirmed
    assert not judged(fix(east_m=4.0), the_pose=steep).confirmed


def test_a_pose_of_the_epoch_before_is_moved_on_for_the_gate_and_not_for_the_road():
    climbing = pose(-1, road=road(slope_east=0.1))
    assert judged(fix(0, up_m=0.2), the_pose=climbing).confirmed  # 2 m driven, 0.2 m climbed


def test_of_several_poses_the_nearest_in_time_counts():
    judge = judge_with(poses=[pose(-1, east_m=50.0), pose(0), pose(1, east_m=50.0)], antenna_height=antenna())
    judgement = judge.judge(fix(), at(0.5), ALL)
    assert judgement.confirmed


def test_an_older_pose_does_not_replace_a_newer():
    judge = judge_with(poses=[pose(0), pose(-1), pose(0, east_m=50.0)])
    assert judge.latest.pose == pose(0)
    assert SettlingJudge(Rules()).latest.pose is None


# --- one verdict each, in order ----------------------------------------------------------------------------------


def test_a_fix_is_judged_once():
    drive = Drive()
    assert drive.epoch(0).confirmed
    assert drive.judge.judge(fix(0), at(0), ALL) is None
    assert drive.judge.judge(fix(0, up_m=5.0), at(1), ALL) is None


def test_another_fix_of_the_same_or_an_earlier_epoch_is_unknown():
    drive = Drive()
    drive.epoch(1)
    repeated = drive.judge.judge(fix(1, fix_id=1), at(1), ALL)
    earlier = drive.judge.judge(fix(0), at(1), ALL)
    assert verdict_and_reason(repeated) == ("unknown", "fix_repeated")
    assert verdict_and_reason(earlier) == ("unknown", "fix_out_of_order")
    assert drive.judge.last_fix_ns == at(1)


def test_what_is_dated_ahead_blocks_nothing_once_it_is_forgotten():
    drive = Drive()
    drive.epoch(0)
    drive.judge.latest.add_pose(pose(1000))
    drive.judge.latest.set_antenna_height(antenna(1000))
    drive.judge.forget_future(at(1))
    assert drive.judge.latest.pose == pose(0)
    without = drive.judge.judge(fix(1), at(1), ALL)
    assert without.reason == "antenna_height_missing"
    assert drive.epoch(2).confirmed


def test_after_the_clock_was_set_back_the_judge_goes_on():
    drive = Drive()
    for k in range(1000, 1003):
        drive.epoch(k)
    drive.judge.forget_future(at(0))
    assert drive.judge.latest.pose is None
    assert drive.judge.last_fix_ns is None
    assert drive.epoch(0).confirmed
    assert (
        drive.epoch(1, fix(1, up_m=0.5)).verdict == "erroneous"
    )  # the chain of later fixes is forgotten: height + 0.5


def test_what_is_current_is_not_forgotten():
    drive = Drive()
    drive.epoch(0)
    drive.judge.forget_future(at(0))
    assert drive.judge.latest.pose == pose(0)
    assert drive.judge.last_fix_ns == at(0)
    assert drive.epoch(1).confirmed
    SettlingJudge(Rules()).forget_future(at(0))


@pytest.mark.parametrize(("ahead_s", "kept"), [(0.49, True), (0.51, False)])
def test_half_a_second_ahead_is_still_now(ahead_s, kept):
    drive = Drive()
    drive.epoch(ahead_s / 0.2)
    drive.judge.forget_future(at(0))
    assert (drive.judge.last_fix_ns is not None, drive.judge.latest.pose is not None) == (kept, kept)


def test_another_estimate_may_take_the_place_of_a_solution_that_is_no_fix():
    judge, asked = judge_with(poses=[pose()], antenna_height=antenna()), []

    def others(judgement):
        asked.append(judgement)
        return judge.examine(fix(0), ALL, trials=3)

    result = judge.judge(fix(0, quality="float"), at(0), ALL, others)
    assert [(one.fix.quality, one.verdict, one.reason) for one in asked] == [
        ("float", "unknown", "not_a_fix")
    ]
    assert (result.fix, result.verdict, result.trials) == (fix(0), "confirmed", 3)
    assert judge.before.chain is not None


# --- verification ------------------------------------------------------------------------------------------------


def off_map(k, height_m=0.4):
    """A pose above which the map is wrong from here on."""
    return pose(k, road=road(elevation_m=ROAD_M - height_m))


def test_where_the_map_is_wrong_the_time_series_carries_a_right_fix():
    drive = Drive()
    assert drive.epoch(0).confirmed
    judgement = drive.epoch(1, the_pose=off_map(1))
    assert judgement.confirmed
    assert verdict_and_reason(judgement) == ("confirmed_after_verification", "height_disagrees")
    assert judgement.evidence == ("time_series",)


@pytest.mark.parametrize(
    ("before", "epoch", "the_fix", "the_pose"),
    [
        (1, 1, fix(1, up_m=0.4), None),
        (1, 1, fix(1, north_m=0.2), off_map(1)),
        (1, 6, None, off_map(6)),
        (0, 0, None, off_map(0)),
        (1, 1, None, provisional(1, road=road(elevation_m=ROAD_M - 0.4))),
    ],
    ids=["jumps", "moved otherwise than the vehicle", "after a second", "no fix before", "provisional pose"],
)
def test_but_it_carries_no_other(before, epoch, the_fix, the_pose):
    drive = Drive()
    assert all(drive.epoch(k).confirmed for k in range(before))
    assert drive.epoch(epoch, the_fix, the_pose).verdict == "erroneous"


def test_nor_where_no_pose_gives_the_displacement_since():
    drive = Drive()
    drive.epoch(0)
    drive.judge.latest.poses.clear()
    assert drive.epoch(4, the_pose=off_map(4)).verdict == "erroneous"


def test_the_chain_of_verified_fixes_ends():
    drive = Drive(speed_m_s=1.0)  # slower than it learns
    drive.epoch(0)
    verdicts = [drive.epoch(k, the_pose=off_map(k)).verdict for k in range(1, 28)]
    assert verdicts == ["confirmed_after_verification"] * 25 + ["erroneous"] * 2


# --- start -------------------------------------------------------------------------------------------------------


def test_from_fixes_alone_the_fifth_in_a_row_is_confirmed():
    drive = Drive()
    judgements = [drive.epoch(k, the_pose=provisional(k)) for k in range(5)]
    assert [j.verdict for j in judgements] == ["unknown"] * 4 + ["confirmed"]
    assert {j.reason for j in judgements[:4]} == {"starting"}
    assert judgements[4].evidence == ("height", "track")


@pytest.mark.parametrize("odd_pose", [provisional, lambda k: provisional(k, mode="anchored")])
@pytest.mark.parametrize(
    "odd",
    [
        lambda drive: drive.epoch(4, fix(4, up_m=1.0), provisional(4)),
        lambda drive: drive.epoch(4, fix(4, north_m=2.0), provisional(4)),
        lambda drive: drive.epoch(4, the_pose=pose(4, mode="none", provenance="none")),
        lambda drive: drive.epoch(4, the_pose=provisional(4, road=no_road())),
    ],
    ids=["height", "position", "no pose", "no road"],
)
def test_one_that_does_not_agree_begins_the_count_anew(odd, odd_pose):
    drive = Drive()
    for k in range(4):
        drive.epoch(k, the_pose=odd_pose(k))
    assert not odd(drive).confirmed
    verdicts = [drive.epoch(k, the_pose=odd_pose(k)).verdict for k in range(5, 10)]
    assert verdicts == ["unknown"] * 4 + ["confirmed"]


def test_a_restart_of_the_pose_elsewhere_begins_the_count_anew():
    """The localizer was killed or lost, and starts again from other fixes: theirs is another row."""
    drive = Drive()
    assert not any(drive.epoch(k, the_pose=provisional(k)).confirmed for k in range(4))
    elsewhere = [drive.epoch(k, fix(k, east_m=30.0), provisional(k, east_m=30.0)) for k in range(4, 9)]
    assert [j.verdict for j in elsewhere] == ["unknown"] * 4 + ["confirmed"]


def test_after_an_anchored_pose_was_lost_the_start_begins_at_zero():
    drive = Drive()
    for k in range(5):
        drive.epoch(k, the_pose=provisional(k))
    assert drive.epoch(5).confirmed
    assert verdict_and_reason(drive.epoch(6, the_pose=provisional(6))) == ("unknown", "starting")


def test_above_a_provisional_pose_a_fix_elsewhere_is_not_known_and_one_off_the_height_is_wrong():
    elsewhere = judged(fix(north_m=2.0), the_pose=provisional())
    assert verdict_and_reason(elsewhere) == ("unknown", "position_disagrees")
    high = judged(fix(up_m=1.0), the_pose=provisional())
    assert verdict_and_reason(high) == ("erroneous", "height_disagrees")
    both = judged(fix(north_m=2.0, up_m=1.0), the_pose=provisional())
    assert verdict_and_reason(both) == ("erroneous", "height_and_position_disagree")


def test_without_a_wheel_speed_nothing_starts():
    drive = Drive(speed_m_s=None)
    assert {drive.epoch(k, the_pose=provisional(k)).reason for k in range(20)} == {"starting"}


def test_a_stale_wheel_speed_starts_nothing():
    drive = Drive(speed_m_s=None)
    drive.judge.latest.add_wheel_speed(at(0), 10.0)
    verdicts = [drive.epoch(k, the_pose=provisional(k)).verdict for k in range(20)]
    assert "confirmed" not in verdicts


# --- learning ----------------------------------------------------------------------------------------------------


def in_force(drive):
    return drive.judge.correction(drive.judge.latest.inputs(at(0), ALL))


def test_right_positions_teach_the_correction_and_later_fixes_are_judged_by_it():
    drive = Drive(rules=BY_GAIN)
    for k in range(300):
        assert drive.epoch(k, fix(k, up_m=0.15)).confirmed
    assert in_force(drive).correction_m == pytest.approx(0.15, abs=0.01)
    assert drive.judge.learning.samples == 300
    assert drive.epoch(300, fix(300, up_m=0.35)).confirmed


def test_a_position_verified_against_the_height_teaches_too():
    drive = Drive(rules=BY_GAIN)
    drive.epoch(0)
    drive.epoch(1, the_pose=off_map(1))
    assert in_force(drive).correction_m == pytest.approx(0.01 * 0.4)


def test_others_teach_nothing():
    drive = Drive(rules=BY_GAIN)
    drive.epoch(0, fix(0, up_m=0.5))
    drive.epoch(1, the_pose=provisional(1))
    drive.epoch(2, the_pose=pose(2, road=no_road()))
    assert in_force(drive) == Correction()


def test_a_vehicle_that_stands_teaches_nothing():
    drive = Drive(rules=BY_GAIN, speed_m_s=0.0)
    assert drive.epoch(0, fix(0, up_m=0.1)).confirmed
    assert drive.judge.learning.samples == 0


def test_the_verdict_has_the_correction_in_force_and_its_sigma_widens_the_tolerance():
    surely = judged(fix(up_m=0.25), learning=Knowing(correction=Correction(correction_m=0.1)))
    assert surely.confirmed
    assert surely.correction_m == 0.1
    hardly = judged(fix(up_m=0.25), learning=Knowing(correction=Correction(correction_m=0.1, sigma_m=0.05)))
    assert hardly.comparison.height_sigma_m == pytest.approx(
        math.hypot(surely.comparison.height_sigma_m, 0.05)
    )
    assert hardly.comparison.height_m == surely.comparison.height_m == pytest.approx(-0.15)


class Listening(Learning):
    """A learning that keeps the residuals it gets."""

    def __init__(self):
        super().__init__(LearningRules())
        self.latest = []

    def update(self, residual):
        self.latest.append(residual)


def test_inputs_are_of_the_services_that_are_alive():
    assert judge_with(poses=[pose()]).inputs(at(0), frozenset({"localizer"})).alive == {"localizer"}


def test_learning_gets_the_difference_without_correction_of_every_compared_fix():
    learning = Listening()
    judged(fix(up_m=0.1, east_m=0.05), learning=learning, the_pose=pose(provenance="scan_match"))
    (residual,) = learning.latest
    assert residual.verdict == "confirmed"
    assert residual.up_m == pytest.approx(0.1)
    assert (residual.east_m, residual.north_m) == pytest.approx((0.05, 0.0), abs=1e-4)
    assert residual.map_sigma_m == 0.03
    assert residual.fix_sigma_m == pytest.approx(math.sqrt((4 * 0.01) ** 2 + 0.05**2 + 0.02**2))
    assert residual.surface_id == 7
    assert residual.key == ReferenceKey(antenna="fixed", base="receiver:WGS84:", map_version=3)


def test_another_base_station_has_another_correction():
    learning = Listening()
    judged(fix(base_station="rtcm-7"), learning=learning)
    judged(fix(base_station="rtcm-8"), learning=learning)
    bases = [residual.key.base for residual in learning.latest]
    assert bases == ["receiver:WGS84:rtcm-7", "receiver:WGS84:rtcm-8"]


def test_of_a_pose_made_of_unconfirmed_fixes_it_gets_the_height_only():
    learning = Listening()
    judged(learning=learning, the_pose=pose(provenance="fixes"))
    assert learning.latest[0].east_m is None
    assert learning.latest[0].up_m is not None


@pytest.mark.parametrize(("mode", "leans"), [("dead_reckoning", True), ("scan_match", False)])
def test_it_gets_the_confirmed_fix_that_anchors_the_pose_and_the_link(mode, leans):
    learning = Listening()
    judged(learning=learning, the_pose=pose(mode=mode, anchor_time_ns=at(-1.0), link_id=4))
    (residual,) = learning.latest
    assert (residual.east_m, residual.link_id) == (0.0, 4)
    assert residual.anchored_ns == (at(-1.0) if leans else None)


@pytest.mark.parametrize("base", ["", "receiver:WGS84:rtcm-8"])
def test_the_correction_of_a_height_without_a_fix_is_that_of_its_antenna_map_and_of_the_newest_base(base):
    known = Correction(correction_m=0.01, sigma_m=0.02)

    class Asked(Learning):
        def correction(self, key):
            of_base = key == ReferenceKey(antenna="fixed", base=base, map_version=3)
            return known if of_base else Correction()

    judge = judge_with(poses=[pose()], antenna_height=antenna(), learning=Asked(LearningRules()))
    inputs = judge.latest.inputs(at(0), ALL)
    assert judge.correction(inputs) == (Correction() if base else known)
    judge.judge(fix(0, base_station="rtcm-7"), at(0), ALL)
    assert judge.correction(inputs) == Correction()
    judge.judge(fix(1, base_station="rtcm-8"), at(1), ALL)
    assert judge.correction(inputs) == (known if base else Correction())


def test_of_a_fix_that_is_not_where_the_vehicle_is_it_gets_the_place_only():
    learning = Listening()
    judged(fix(east_m=3.0), learning=learning, the_pose=pose(provenance="scan_match"))
    assert learning.latest[0].verdict == "erroneous"
    assert learning.latest[0].east_m == pytest.approx(3.0, abs=1e-3)
    assert learning.latest[0].up_m is None


def test_of_a_fix_that_was_not_compared_it_gets_the_independent_position_the_antenna_and_the_speed():
    learning = Listening()
    there = pose(road=no_road(), independent=independent(basis="relief"))
    judge = judge_with(poses=[there], antenna_height=antenna(), learning=learning)
    judge.latest.add_wheel_speed(at(0), 8.0)
    assert judge.judge(fix(), at(0), ALL).comparison is None
    (residual,) = learning.latest
    assert (residual.key.antenna, residual.speed_m_s) == ("fixed", 8.0)
    assert residual.known_independent is not None


def test_where_nothing_was_compared_it_gets_nothing():
    learning = Listening()
    judged(learning=learning, the_pose=pose(road=no_road()))
    judged(fix(quality="float"), learning=learning)
    assert learning.latest == []


# --- properties --------------------------------------------------------------------------------------------------

TRUST = {"erroneous": 0, "unknown": 0, "confirmed_after_verification": 1, "confirmed": 2}


@settings(deadline=None, derandomize=True)
@given(
    near_m=st.floats(0.0, 5.0),
    farther_m=st.floats(0.0, 5.0),
    sign=st.sampled_from([-1.0, 1.0]),
    history=st.integers(0, 6),
)
def test_a_larger_height_contradiction_never_raises_trust(near_m, farther_m, sign, history):
    def trust(up_m):
        drive = Drive()
        for k in range(history):
            drive.epoch(k)
        return TRUST[drive.epoch(history, fix(history, up_m=sign * up_m)).verdict]

    assert trust(near_m + farther_m) <= trust(near_m)


@settings(deadline=None, derandomize=True)
@given(near_m=st.floats(0.0, 5.0), farther_m=st.floats(0.0, 5.0))
def test_a_larger_distance_from_the_pose_never_raises_trust(near_m, farther_m):
    assert (
        TRUST[judged(fix(north_m=near_m + farther_m)).verdict] <= TRUST[judged(fix(north_m=near_m)).verdict]
    )


ages_epochs = st.floats(-30.0, 30.0)


@settings(deadline=None, derandomize=True)
@given(pose_age=ages_epochs, antenna_age=ages_epochs, fix_age=ages_epochs)
def test_stale_or_missing_input_never_gives_confirmation(pose_age, antenna_age, fix_age):
    judgement = judged(fix(0), now=fix_age, the_pose=pose(-pose_age), the_antenna=antenna(-antenna_age))
    fresh = abs(pose_age) <= 1.5 and abs(antenna_age) <= 10.0 and -2.5 <= fix_age <= 2.5
    assert judgement.confirmed is fresh


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.sampled_from(["float", "dgps", "single", "ppp", "sbas", "estimated", "none"]), st.floats(-1.0, 1.0))
def test_nothing_but_a_fix_is_ever_confirmed(quality, up_m):
    assert not judged(fix(quality=quality, up_m=up_m)).confirmed


@settings(deadline=None, derandomize=True)
@given(st.lists(st.sampled_from(["right"] * 4 + ["high", "horizontal", "no_pose", "no_road"]), max_size=30))
def test_along_any_provisional_drive_a_fix_is_confirmed_after_five_that_agree_and_no_sooner(events):
    drive = Drive()
    for k, event in enumerate(events):
        the_fix = {"high": fix(k, up_m=1.0), "horizontal": fix(k, north_m=3.0)}.get(event, fix(k))
        the_pose = {
            "no_pose": pose(k, mode="none", provenance="none"),
            "no_road": provisional(k, road=no_road()),
        }.get(event, provisional(k))
        five = events[: k + 1][-5:] == ["right"] * 5
        assert drive.epoch(k, the_fix, the_pose).confirmed is five


# --- each test alone and together --------------------------------------------------------------------------------


def by(*tests, **changes):
    return Rules(determination=ConsistencyParameters(tests=tests, **changes))


AGAINST = {
    "height": ({"the_fix": fix(up_m=0.6)}, ("erroneous", "height_disagrees")),
    "position": ({"the_fix": fix(north_m=1.0)}, ("erroneous", "position_disagrees")),
    "joint": ({"the_fix": fix(up_m=0.6)}, ("erroneous", "height_and_position_disagree")),
    "phase_residuals": (
        {"the_fix": fix(phase_residuals="contradictory")},
        ("erroneous", "phase_residuals_contradict"),
    ),
    "subset_agreement": ({"the_fix": fix(subset_agreement="disagree")}, ("unknown", "subsets_disagree")),
    "receiver": ({"statement": {"raim": "failed"}}, ("unknown", "receiver_warns")),
}


@pytest.mark.parametrize("test", AGAINST)
def test_each_test_alone_names_its_reason(test):
    changes, expected = AGAINST[test]
    alone = by(test) if test not in ("receiver",) else by("height", test)
    assert verdict_and_reason(judged(rules=alone, **changes)) == expected


@pytest.mark.parametrize("test", AGAINST)
def test_a_test_that_is_not_asked_holds_nothing_back(test):
    others = tuple(other for other in ("height", "position", "receiver") if other != test)
    if test == "joint":
        others = ("position", "receiver")
    assert judged(rules=by(*others), **AGAINST[test][0]).confirmed


def test_all_tests_together_name_what_is_nearest_to_the_cause():
    everything = {"the_fix": fix(up_m=0.6, north_m=1.0), "statement": {"raim": "failed"}}
    assert judged(**everything).reason == "receiver_warns"
    contradictory = fix(up_m=0.6, phase_residuals="contradictory")
    assert judged(contradictory, statement={"raim": "failed"}).reason == "phase_residuals_contradict"
    assert judged(fix(up_m=0.6, north_m=1.0)).reason == "height_and_position_disagree"


def test_without_the_height_neither_road_nor_antenna_is_needed():
    nothing = {"the_pose": pose(road=no_road()), "the_antenna": antenna(status="unknown")}
    judgement = judged(rules=by("position"), **nothing)
    assert verdict_and_reason(judgement) == ("confirmed", "none")
    assert judgement.evidence == ("consistency",)
    assert judged(**nothing).verdict == "unknown"
    assert judged(rules=by("position"), the_pose=pose(road=road(datum=None))).confirmed
    assert judged(fix(datum="JGD2011"), rules=by("position")).reason == "datum_mismatch"


def test_without_the_height_a_wide_pose_confirms_nothing():
    wide = judged(rules=by("position"), the_pose=pose(sigma_m=3.0))
    assert verdict_and_reason(wide) == ("unknown", "position_unverified")
    assert not judged(rules=by("position"), the_pose=provisional()).confirmed


def test_a_wide_pose_costs_a_right_fix_nothing_and_is_no_evidence():
    judgement = judged(fix(north_m=2.0), the_pose=pose(sigma_m=3.0))
    assert judgement.confirmed
    assert judgement.evidence == ("height",)


def test_residuals_alone_confirm_only_what_is_consistent():
    alone = by("phase_residuals")
    consistent = judged(fix(phase_residuals="consistent"), rules=alone)
    assert consistent.evidence == ("phase_residuals",)
    assert consistent.confirmed
    unknown = judged(rules=alone)
    assert verdict_and_reason(unknown) == ("unknown", "height_unverified")
    assert "nothing" in unknown.detail


def test_consistent_residuals_are_listed_with_the_other_evidence():
    assert judged(fix(phase_residuals="consistent")).evidence == ("height", "consistency", "phase_residuals")


def test_subsets_alone_confirm_only_what_agrees():
    alone = by("subset_agreement")
    assert judged(fix(subset_agreement="agree"), rules=alone).evidence == ("subset_agreement",)
    assert verdict_and_reason(judged(rules=alone)) == ("unknown", "height_unverified")
    assert judged(fix(subset_agreement="agree"), rules=by("height")).evidence == ("height",)
    assert judged(fix(subset_agreement="agree")).evidence == ("height", "consistency", "subset_agreement")


def test_subsets_that_disagree_are_the_reason_only_where_all_else_agrees():
    split = {"subset_agreement": "disagree"}
    for changes in (
        {"the_fix": fix(up_m=0.6, **split)},
        {"the_fix": fix(north_m=1.0, **split)},
        {"the_fix": fix(phase_residuals="contradictory", **split)},
        {"the_fix": fix(**split), "the_pose": pose(road=no_road())},
    ):
        unsplit = changes["the_fix"].model_copy(update={"subset_agreement": "unknown"})
        assert verdict_and_reason(judged(**changes)) == verdict_and_reason(
            judged(**{**changes, "the_fix": unsplit})
        )
    held = judged(fix(**split))
    assert (held.evidence, held.detail) == ((), "without one system its satellites are fixed elsewhere")


def test_a_fix_whose_subsets_disagree_is_confirmed_where_enough_else_speaks_for_it():
    drive = Drive()
    drive.epoch(0)
    carried = drive.epoch(1, fix(1, subset_agreement="disagree"))
    assert verdict_and_reason(carried) == ("confirmed_after_verification", "subsets_disagree")
    assert carried.evidence == ("time_series",)
    assert carried.detail == "without one system its satellites are fixed elsewhere"
    vague = fix(2, subset_agreement="disagree", covariance_enu_m2=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    assert verdict_and_reason(drive.epoch(2, vague)) == ("unknown", "subsets_disagree")


def test_a_fix_whose_subsets_disagree_does_not_count_at_the_start():
    drive = Drive()
    verdicts = [
        drive.epoch(k, fix(k, subset_agreement="disagree" if k == 4 else "agree"), provisional(k))
        for k in range(10)
    ]
    assert [judgement.reason for judgement in verdicts[:5]] == ["starting"] * 4 + ["subsets_disagree"]
    assert [judgement.confirmed for judgement in verdicts] == [False] * 9 + [True]


def test_the_fixed_tolerance_is_that_of_the_document():
    document = by("height", tolerance="fixed", tolerance_m=0.2)
    assert judged(fix(up_m=0.19), rules=document).confirmed
    assert verdict_and_reason(judged(fix(up_m=0.21), rules=document)) == ("erroneous", "height_disagrees")
    assert judged(rules=document, the_pose=pose(road=road(sigma_m=0.25))).reason == "road_unknown"


def test_where_every_fix_is_off_alike_a_contradiction_is_not_the_fixes():
    base = Knowing(cause="base")
    for off in (fix(up_m=0.6), fix(north_m=2.0), fix(up_m=0.29), fix(east_m=30.0)):
        judgement = judged(off, learning=base)
        assert verdict_and_reason(judgement) == ("unknown", "common_offset")
        assert judgement.cause == "base"
        assert judgement.detail.split(":")[0].endswith(("disagrees", "unverified"))
    assert judged(learning=base).confirmed
    assert judged(fix(up_m=0.6), learning=Knowing(cause="antenna")).verdict == "erroneous"
    # Only where the fix itself contradicts the pose it carries no information on the road.
    assert judged(fix(north_m=2.0), learning=base).road is not None
    assert judged(fix(north_m=2.0)).road is None


def test_a_fix_beyond_the_road_and_off_the_pose_contradicts_the_pose():
    off = judged(fix(east_m=30.0))
    assert verdict_and_reason(off) == ("erroneous", "position_disagrees")
    assert off.comparison.position_m == pytest.approx((30.0, 0.0), abs=1e-2)
    in_doubt = judged(fix(east_m=30.0), rules=by("height"))
    assert verdict_and_reason(in_doubt) == ("unknown", "pose_too_uncertain")
    assert in_doubt.detail == "the fix is beyond the surface's plane"


# --- integers, sweeps and phases ---------------------------------------------------------------------------------


def chained(k, continuity="continuous", since=0, **changes):
    return fix(k, ambiguity_continuity=continuity, continuous_since_ns=at(since), **changes)


def drive_of_five():
    """A drive whose integers five fixes have confirmed."""
    drive = Drive()
    assert all(drive.epoch(k, chained(k)).evidence[0] == "height" for k in range(5))
    return drive


def far_off_map(k):
    return off_map(k, 0.6)


def test_integers_that_the_height_has_confirmed_carry_a_fix_over_a_road_that_is_wrong():
    drive = drive_of_five()
    drive.epoch(5, the_pose=pose(5, road=no_road()))
    judgement = drive.epoch(20, chained(20), far_off_map(20))  # 3 s later: no time series
    assert verdict_and_reason(judgement) == ("confirmed_after_verification", "height_disagrees")
    assert judgement.evidence == ("ambiguity_continuity",)


def test_a_fix_with_a_large_sigma_is_not_verified():
    drive = drive_of_five()
    wide = (2.5e-5, 0.0, 0.0, 2.5e-5, 0.0, 0.04**2)
    assert drive.epoch(5, chained(5, covariance_enu_m2=wide), off_map(5, 1.5)).verdict == "erroneous"
    assert drive.epoch(6, chained(6), off_map(6, 1.5)).confirmed


def test_a_fix_with_a_large_sigma_verifies_no_other():
    drive = Drive()
    wide = (2.5e-5, 0.0, 0.0, 2.5e-5, 0.0, 0.04**2)
    assert drive.epoch(0, fix(0, covariance_enu_m2=wide)).confirmed
    assert drive.epoch(1, the_pose=far_off_map(1)).verdict == "erroneous"


def test_nothing_is_verified_that_is_not_where_the_pose_is():
    drive = drive_of_five()
    assert not drive.epoch(5, chained(5, north_m=0.5), far_off_map(5)).confirmed
    assert not drive.epoch(6, chained(6, north_m=1.0), far_off_map(6)).confirmed
    assert drive.epoch(7, chained(7, north_m=1.0)).reason == "position_disagrees"


def test_where_the_pose_is_in_doubt_integers_that_were_confirmed_carry_a_fix_that_the_height_agrees_with():
    drive = drive_of_five()
    judgement = drive.epoch(5, chained(5, north_m=0.5))
    assert verdict_and_reason(judgement) == ("confirmed_after_verification", "position_unverified")
    assert judgement.evidence == ("ambiguity_continuity",)


def test_but_neither_the_time_series_nor_sweeps_that_are_elsewhere():
    drive = Drive()
    drive.epoch(0)
    horizontal = [drive.epoch(k, fix(k, north_m=0.12 * k)) for k in range(1, 5)]
    assert [judgement.verdict for judgement in horizontal] == ["confirmed"] * 3 + ["unknown"]
    fitting = fix(north_m=0.5, phase_residuals="consistent", ambiguities_fixed=12)
    assert judged(fitting, the_pose=matched(0)).reason == "position_unverified"
    assert not judged(fitting, the_pose=matched(0)).confirmed


def test_other_integers_than_those_just_confirmed_are_not_known_until_they_have_lasted_a_second():
    drive = drive_of_five()
    held = drive.epoch(5, chained(5, "broken", 5))
    assert verdict_and_reason(held) == ("unknown", "continuity_disagrees")
    assert "0.2 s ago" in held.detail
    later = [drive.epoch(k, chained(k, since=5)).verdict for k in range(6, 12)]
    assert later == ["unknown"] * 4 + ["confirmed"] * 2


def test_continuity_that_is_not_asked_holds_nothing_back():
    drive = Drive(rules=by("height", "position"))
    drive.epoch(0, chained(0))
    assert drive.epoch(1, chained(1, "broken", 1)).confirmed


def matched(k, **changes):
    return pose(k, mode="scan_match", provenance="scan_match", match_time_ns=at(k), **changes)


def test_sweeps_and_phases_together_carry_a_fix_neither_alone():
    model = road(elevation_m=ROAD_M - 0.6)
    fitting = {"phase_residuals": "consistent", "ambiguities_fixed": 12}
    both = judged(fix(**fitting), the_pose=matched(0, road=model))
    assert both.verdict == "confirmed_after_verification"
    assert both.evidence == ("scan_matching", "phase_residuals")
    assert judged(fix(), the_pose=matched(0, road=model)).verdict == "erroneous"
    assert judged(fix(**fitting), the_pose=pose(road=model)).verdict == "erroneous"
    assert judged(fix(**fitting), the_pose=matched(0, road=model, sigma_m=0.2)).verdict == "erroneous"
    assert not judged(fix(north_m=0.5, **fitting), the_pose=matched(0, road=model)).confirmed
    height_only = by("height")
    assert judged(fix(**fitting), the_pose=matched(0, road=model), rules=height_only).verdict == "erroneous"


def test_what_is_examined_leaves_no_trace_until_it_is_settled():
    drive = Drive()
    drive.epoch(0)
    drive.judge.latest.add_pose(far_off_map(1))
    drive.judge.latest.set_antenna_height(antenna(1))
    again = [drive.judge.examine(fix(1), ALL) for _ in range(2)]
    assert [judgement.verdict for judgement in again] == ["confirmed_after_verification"] * 2
    assert drive.judge.before.chain.chain_length == 0
    drive.judge.settle(again[0])
    assert drive.judge.before.chain.chain_length == 1


def test_the_receivers_warning_is_forgotten_with_the_clock():
    drive = Drive()
    drive.judge.latest.receiver.update(ReceiverIntegrity(time_ns=at(3), spoofing="affirmed"))
    assert drive.epoch(1).reason == "receiver_warns"
    drive.judge.forget_future(at(0))
    assert drive.epoch(2).confirmed


def test_integers_of_a_future_that_was_none_are_forgotten():
    drive = Drive()
    for k in range(100, 105):
        drive.epoch(k, chained(k, since=100))
    drive.judge.forget_future(at(0))
    assert drive.judge.before.integers.confirmed == 0


# --- more properties ---------------------------------------------------------------------------------------------


@settings(deadline=None, derandomize=True)
@given(
    up_m=st.floats(-2.0, 2.0),
    north_m=st.floats(-2.0, 2.0),
    road_sigma_m=st.floats(0.0, 2.0),
    wider=st.floats(1.0, 10.0),
    pose_sigma_m=st.floats(0.02, 5.0),
)
def test_more_uncertainty_never_confirms_what_is_beyond_the_cap(
    up_m, north_m, road_sigma_m, wider, pose_sigma_m
):
    judgement = judged(
        fix(up_m=up_m, north_m=north_m),
        the_pose=pose(sigma_m=pose_sigma_m, road=road(sigma_m=road_sigma_m * wider)),
    )
    assert abs(up_m) <= 0.3 + 1e-9 or not judgement.confirmed


@settings(deadline=None, derandomize=True)
@given(
    st.sampled_from(["broken", "continuous", "no_evidence"]),
    st.sampled_from(["contradictory", "unknown", "consistent"]),
    st.sampled_from(["none", "indicated", "affirmed", "unknown"]),
    st.sampled_from(["agree", "disagree", "unknown"]),
    st.floats(-1.0, 1.0),
)
def test_no_state_of_receiver_or_engine_makes_up_for_the_height(
    continuity, residuals, spoofing, subsets, up_m
):
    the_fix = fix(
        up_m=up_m,
        ambiguity_continuity=continuity,
        continuous_since_ns=at(0),
        phase_residuals=residuals,
        ambiguities_fixed=20,
        subset_agreement=subsets,
    )
    judgement = judged(the_fix, statement={"spoofing": spoofing})
    if judgement.confirmed:
        assert judged(fix(up_m=up_m)).confirmed
        assert residuals != "contradictory"
        assert subsets != "disagree"
        assert spoofing in ("none", "unknown")


# --- the independent position --------------------------------------------------------------------------------------


def beside(sigma_m=0.1, **place):
    """A pose of confirmed fixes at the origin, with an independent position beside it."""
    return pose(independent=independent(sigma_m=sigma_m, **place))


def test_only_what_agrees_with_the_independent_position_is_position_evidence():
    assert judged(the_pose=beside()).evidence == ("height", "position", "consistency")
    assert judged(the_pose=beside(sigma_m=3.0)).evidence == (
        "height",
        "consistency",
    )  # too wide to contradict
    matched = {"mode": "scan_match", "provenance": "scan_match"}
    assert judged(the_pose=pose(**matched)).evidence == ("height",)
    assert judged(the_pose=pose(**matched, independent=independent())).evidence == ("height", "position")


def test_where_base_and_signals_are_honest_the_pose_is_position_evidence_too():
    rules = Rules(horizontal_reference="assumed")
    for the_pose in (pose(), beside(north_m=20.0)):
        judgement = judged(the_pose=the_pose, rules=rules)
        assert (judgement.verdict, judgement.evidence) == ("confirmed", ("height", "position"))


def test_a_fix_that_agrees_with_a_pose_of_fixes_and_not_with_the_independent_position_is_unknown():
    """The base is 2 m off: fixes and pose agree, and nothing tells whether they or the scan match are wrong."""
    judgement = judged(the_pose=beside(north_m=-2.0))
    assert verdict_and_reason(judgement) == ("unknown", "position_disagrees")
    assert "2.00 m from the independent position of σ 0.10 m (scan_match, 0 m ago)" in judgement.detail


def test_neither_series_nor_integers_verify_a_fix_that_the_independent_position_contradicts():
    drive = Drive()
    drive.epoch(0, the_pose=pose(independent=independent()))
    raised = {"road": road(elevation_m=ROAD_M + 0.5)}
    there = pose(1, independent=independent(1), **raised)
    assert drive.epoch(1, the_pose=there).verdict == "confirmed_after_verification"
    elsewhere = pose(2, independent=independent(2, north_m=2.0), **raised)
    assert verdict_and_reason(drive.epoch(2, the_pose=elsewhere)) == ("erroneous", "height_disagrees")


def test_between_agreement_and_contradiction_it_holds_a_fix_back():
    judgement = judged(the_pose=beside(north_m=0.6))
    assert verdict_and_reason(judgement) == ("unknown", "position_unverified")
    assert "independent" in judgement.detail


def test_a_fix_that_both_contradict_is_erroneous():
    assert verdict_and_reason(judged(fix(north_m=3.0), the_pose=beside())) == (
        "erroneous",
        "position_disagrees",
    )


def test_a_fix_at_the_independent_position_puts_the_pose_of_fixes_in_doubt():
    away = judged(fix(north_m=3.0), the_pose=beside(north_m=3.0))
    assert verdict_and_reason(away) == ("unknown", "position_disagrees")
    matched = pose(mode="scan_match", provenance="scan_match", independent=independent(north_m=3.0))
    assert judged(fix(north_m=3.0), the_pose=matched).verdict == "erroneous"  # no fix has anchored it
    wide = judged(fix(north_m=3.0), the_pose=beside(sigma_m=9.0))
    assert wide.verdict == "erroneous"  # it agrees with everything


def led_away(has_independent):
    """The cause that is named of fixes led away by 0.3 m/s while the pose is too uncertain to compare them."""
    drive = Drive()
    for k in range(225):
        known = independent(k, sigma_m=0.3) if has_independent else None
        the_pose = pose(k, sigma_m=50.0, independent=known)
        judgement = drive.epoch(k, fix(k, north_m=max(0.0, 0.06 * (k - 50))), the_pose=the_pose)
        assert verdict_and_reason(judgement) == ("unknown", "pose_too_uncertain")
    return drive.judge.learning.diagnosis(None).cause


def test_what_leads_fixes_away_is_named_while_the_pose_is_too_uncertain():
    assert led_away(has_independent=True) == "drift"
    assert led_away(has_independent=False) == "none"


@pytest.mark.parametrize("cause", ["base", "drift"])
def test_where_all_fixes_have_one_offset_from_it_none_is_confirmed(cause):
    judgement = judged(the_pose=beside(), learning=Knowing(cause))
    assert verdict_and_reason(judgement) == ("unknown", "common_offset")
    assert judged(learning=Knowing(cause)).confirmed  # nothing here shows it horizontally


def test_where_no_position_is_tested_the_independent_one_is_not_asked():
    judgement = judged(rules=by("height"), the_pose=beside(north_m=-20.0))
    assert (judgement.verdict, judgement.evidence) == ("confirmed", ("height",))
