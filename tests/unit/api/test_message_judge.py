"""The judge as a library: the verdicts of a replay, without bus, environment or files."""

import pytest

import camber
from camber.replay.short_drive import write_short_drive
from camber.schemas.drive import ManifestError
from camber.schemas.gnss import Estimates
from support.judging import antenna, at, fix, pose


def fix_verdicts(judgements):
    return [verdict for step in judgements for verdict in step.verdicts if verdict.fix_id is not None]


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    drive = write_short_drive(tmp_path_factory.mktemp("drive") / "short", 1)
    return camber.replay_drive(drive, overrides=["end_s=30.0"])


def test_the_verdicts_on_a_drive_are_those_of_its_replay(replayed):
    inputs = [name for name in replayed.messages if name not in ("verdict", "position")]
    messages = sorted(
        (message.time_ns, order, number, message)
        for order, name in enumerate(inputs)
        for number, message in enumerate(replayed.messages[name])
    )
    judge, judgements = camber.Judge(), []
    for time_ns in dict.fromkeys(item[0] for item in messages):
        for item in messages:
            if item[0] == time_ns:
                judge.add(item[3])
        judgements.append(judge.advance(time_ns))
    expected = [verdict for verdict in replayed.messages["verdict"] if verdict.fix_id is not None]
    assert fix_verdicts(judgements) == expected
    values = {verdict.verdict for verdict in expected}
    assert values >= {"confirmed", "unknown"}, "the drive shows more than one"


def test_one_fix_is_confirmed_by_height_and_pose():
    verdict = camber.judge(fix(0), pose=pose(0), antenna_height=antenna(0))
    assert verdict.verdict == "confirmed"
    assert verdict.fix_id == fix(0).fix_id


def test_one_fix_metres_too_high_is_erroneous():
    off = fix(0, up_m=3.0)
    assert camber.judge(off, pose=pose(0), antenna_height=antenna(0)).verdict == "erroneous"


def test_a_fix_without_a_pose_of_its_time_is_unknown():
    verdict = camber.judge(fix(20), pose=pose(0), antenna_height=antenna(20))
    assert (verdict.verdict, verdict.reason) == ("unknown", "pose_stale")


def test_settings_are_those_given_and_not_those_of_the_environment(monkeypatch):
    monkeypatch.setenv("CAMBER_ALERT_LIMIT_M", "7.5")
    judge = camber.Judge({"horizontal_reference": "assumed"})
    for message in (pose(0), antenna(0), fix(0)):
        judge.add(message)
    (position, *_) = judge.advance(at(0)).positions
    assert position.alert_limit_m == 1.5
    assert position.horizontal_reference == "assumed"


def test_a_setting_that_cannot_be_is_named():
    with pytest.raises(ManifestError, match="integrity: alert_limit_m"):
        camber.Judge({"alert_limit_m": -1.0})


def test_a_message_that_the_judge_does_not_take_is_named():
    with pytest.raises(TypeError, match=r"a message Estimates, expected one of .*Fix.*Pose"):
        camber.Judge().add(Estimates(time_ns=at(0), fix_id=0, status="unavailable"))


def test_without_input_it_says_why_there_is_no_position():
    judgements = camber.Judge().advance(at(0))
    assert [verdict.verdict for verdict in judgements.verdicts] == ["unknown"]
    assert not any(position.usable for position in judgements.positions)
