"""What a judgement has besides the verdict: detail, cause, correction in force."""

import math
import re

import pytest

from camber.integrity.checks.consistency_tests import ConsistencyParameters
from camber.integrity.learning.height_correction import Correction, Learning, LearningRules
from camber.integrity.learning.offset_causes import Diagnosis
from camber.integrity.learning.residuals import ReferenceKey
from camber.integrity.rules import Rules
from camber.schemas.gnss import ReceiverIntegrity
from support.judging import ALL, SPEED_M_S, SettlingJudge, antenna, at, fix, pose, provisional, road


class Knowing(Learning):
    """Knows that surface 7 has changed, and the correction of one antenna, base and map."""

    def __init__(self, correction=None):
        super().__init__(LearningRules())
        self._known = correction or Correction(correction_m=0.01, sigma_m=0.02)

    def diagnosis(self, surface_id):
        return Diagnosis(cause="road" if surface_id == 7 else "none")

    def correction(self, key):
        return (
            self._known
            if key == ReferenceKey(antenna="fixed", base="receiver:WGS84:", map_version=3)
            else Correction()
        )


def examined(the_fix=None, the_pose=None, learning=None, rules=None):
    judge = SettlingJudge(rules or Rules(), learning or Knowing())
    judge.latest.add_pose(the_pose or pose())
    judge.latest.set_antenna_height(antenna())
    judge.latest.add_wheel_speed(at(0), SPEED_M_S)
    return judge.examine(the_fix or fix(), ALL)


def test_the_cause_is_that_of_the_road_below_the_fix():
    assert examined().cause == "road"


def test_a_judgement_without_comparison_has_the_correction_too():
    assert examined().correction_m == 0.01
    assert examined(fix(datum="ITRF2020")).correction_m == 0.0
    assert examined(fix(phase_residuals="contradictory")).correction_m == 0.01


@pytest.mark.parametrize(
    ("asked", "reason", "detail"),
    [
        ({"the_fix": fix(datum="ITRF2020")}, "datum_mismatch", "fix ITRF2020, map WGS84"),
        ({"the_pose": provisional()}, "starting", "1 in a row agree, 5 are needed"),
        (
            {"learning": Knowing(Correction(correction_m=math.nan, sigma_m=0.01))},
            "road_unknown",
            "the height is not a number",
        ),
        (
            {"rules": Rules(determination=ConsistencyParameters(tests=("phase_residuals",)))},
            "height_unverified",
            "nothing that is asked speaks for the fix",
        ),
        (
            {"the_fix": fix(subset_agreement="disagree")},
            "subsets_disagree",
            "without one system its satellites are fixed elsewhere",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_detail_says_what_is_missing(asked, reason, detail):
    result = examined(**asked)
    assert (result.verdict, result.reason, result.detail) == ("unknown", reason, detail)


def test_a_road_that_is_known_too_vaguely_says_how_vaguely():
    result = examined(the_pose=pose(road=road(sigma_m=2.0)))
    assert (result.verdict, result.reason) == ("unknown", "road_unknown")
    assert re.fullmatch(
        r"σ 2\.00 m of road and antenna, expected at most the largest tolerance, [0-9.]+ m", result.detail
    )


def test_the_detail_has_the_warning_of_the_receiver():
    judge = SettlingJudge(Rules(), Knowing())
    judge.latest.receiver.update(ReceiverIntegrity(time_ns=at(0), spoofing="affirmed"))
    result = judge.examine(fix(), ALL)
    assert (result.verdict, result.reason, result.detail) == (
        "unknown",
        "receiver_warns",
        "spoofing affirmed",
    )


def test_a_solution_that_is_no_fix_leaves_the_start_as_it_was():
    judge = SettlingJudge(Rules(), Knowing())
    verdicts = []
    for k in range(6):
        judge.latest.add_pose(provisional(k))
        judge.latest.set_antenna_height(antenna(k))
        judge.latest.add_wheel_speed(at(k), SPEED_M_S)
        verdicts.append(judge.judge(fix(k, quality="float" if k == 3 else "fixed"), at(k), ALL).reason)
    assert verdicts == ["starting", "starting", "starting", "not_a_fix", "starting", "height_agrees"]
