"""The judge's process: one verdict a fix, a position an epoch, and never silence."""

import itertools
from collections import Counter
from contextlib import closing

import pytest

from camber.integrity.service import SERVICE, IntegrityService
from camber.integrity.settings import IntegritySettings
from camber.runtime.uploads.outbox import Outbox
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import decode
from camber.schemas.fleet import UploadBatch
from camber.schemas.motion import Motion
from support.judging import ALL, antenna, at, fix, pose, provisional, road


class BusWithoutWires:
    """What the service uses of a bus."""

    def __init__(self):
        self.time_ns = at(0)
        self.alive = set(ALL)
        self.sent = []
        self.issues = {}
        self.counters = Counter()

    def now_ns(self):
        return self.time_ns

    def is_alive(self, service):
        return service in self.alive

    def publish(self, name, message):
        self.sent.append((name, message))

    def issue(self, code, text):
        self.issues[code] = text

    def count(self, name, n=1):
        self.counters[name] += n

    def ask_bytes(self, name, data):
        raise RuntimeError("nobody answers")


class Rig:
    """The service on a bus without wires; time in epochs."""

    def __init__(self, **settings):
        self.bus = BusWithoutWires()
        self.service = IntegrityService(IntegritySettings(**settings), self.bus)
        self.handlers = self.service.handlers()

    def update(self, **messages):
        for name, message in messages.items():
            self.handlers[name](message)

    def advance(self, epoch):
        self.bus.time_ns = at(epoch)
        self.service.advance(at(epoch))
        return self.take()

    def take(self):
        sent, self.bus.sent = self.bus.sent, []
        return sent

    def epoch(self, k, **changes):
        """A whole epoch, right but for what is given; None: not received."""
        self.bus.time_ns = at(k)
        messages = {
            "motion": Motion(time_ns=at(k), wheel_speed_m_s=10.0),
            "antenna_height": antenna(k),
            "pose": pose(k),
            "fix": fix(k),
        } | changes
        self.update(**{name: message for name, message in messages.items() if message is not None})
        return self.advance(k)


def of(sent, name):
    return [message for channel, message in sent if channel == name]


def verdicts(sent):
    return [(verdict.verdict, verdict.reason) for verdict in of(sent, "verdict")]


@pytest.fixture
def rig():
    return Rig()


@pytest.fixture
def kept(tmp_path):
    """A rig that keeps its state."""
    return Rig(state_dir=tmp_path / "state")


def test_it_is_the_service_that_the_command_runs():
    assert SERVICE is IntegrityService
    assert SERVICE.NAME == "integrity"


# --- verdicts and positions --------------------------------------------------------------------------------------


def test_a_right_fix_has_a_verdict_and_is_the_position_of_its_epoch(rig):
    sent = rig.epoch(0)
    assert verdicts(sent) == [("confirmed", "height_agrees")]
    (position,) = of(sent, "position")
    assert (position.source, position.usable, position.reason) == ("rtk", False, "no_independent_position")
    assert position.horizontal_protection_level_m is None
    assert position.horizontal_reference == of(sent, "verdict")[0].horizontal_reference == "required"


def test_with_an_honest_base_a_right_fix_has_a_level_and_the_messages_say_so():
    sent = Rig(horizontal_reference="assumed").epoch(0)
    assert verdicts(sent) == [("confirmed", "height_agrees")]
    (position,) = of(sent, "position")
    assert position.horizontal_reference == of(sent, "verdict")[0].horizontal_reference == "assumed"
    assert position.horizontal_protection_level_m > position.semi_major_999_m
    # The pose rests on fixes that were confirmed before this judge was there: it does not speak for this one.
    assert (position.usable, position.reason) == (False, "position_unverified")


def test_the_pose_of_the_same_epoch_does_not_overwrite_it_before_or_after(rig):
    sent = rig.epoch(0)
    rig.update(pose=pose(0.05))  # 10 ms later by the vehicle's own clock
    sent += rig.advance(0.05)
    assert [p.source for p in of(sent, "position")] == ["rtk"]


def test_it_says_how_much_waits(rig, kept):
    rig.update(fix=fix(0))
    assert rig.service.gauges() == {"fixes_waiting": 1.0}
    assert kept.service.gauges()["uploads_not_stored"] == 0.0
    kept.service.close()


def test_a_fix_that_is_not_confirmed_leaves_the_epoch_to_the_pose(rig):
    sent = rig.epoch(0, fix=fix(0, up_m=1.0))
    assert verdicts(sent) == [("erroneous", "height_disagrees")]
    assert [(p.source, p.fix_id) for p in of(sent, "position")] == [("sensors", None)]


def test_a_late_fix_does_not_bring_back_an_old_pose(rig):
    rig.epoch(0, fix=None)
    rig.epoch(1, fix=None)
    rig.update(fix=fix(0))
    sent = rig.advance(1.2)
    assert [(p.source, p.time_ns) for p in of(sent, "position")] == [("rtk", at(0))]


def test_a_fix_that_comes_twice_has_one_verdict(rig):
    sent = rig.epoch(0)
    rig.update(fix=fix(0))
    sent += rig.advance(0.5)
    assert len([v for v in of(sent, "verdict") if v.fix_id is not None]) == 1
    assert rig.bus.counters["fix.judged_already"] == 1


def test_a_provisional_pose_gives_no_position(rig):
    (position,) = of(rig.epoch(0, pose=provisional(0), fix=None), "position")
    assert not position.usable
    assert position.reason == "pose_provisional"


def test_verdicts_are_counted_by_value(rig):
    rig.epoch(0)
    rig.epoch(1, fix=fix(1, up_m=1.0))
    assert rig.bus.counters["verdict.confirmed"] == rig.bus.counters["verdict.erroneous"] == 1


# --- waiting for the pose of the epoch ---------------------------------------------------------------------------

MS = 1.0 / 200.0  # of an epoch


def test_a_fix_waits_a_little_for_the_pose_of_its_epoch(rig):
    rig.epoch(0)
    rig.bus.time_ns = at(1)
    rig.update(fix=fix(1))
    assert verdicts(rig.advance(1)) == []
    rig.update(pose=pose(1))
    assert verdicts(rig.advance(1 + 10 * MS)) == [("confirmed", "height_agrees")]


def test_but_not_longer_than_20_ms_where_the_localizer_is_frozen(rig):
    rig.epoch(0)
    rig.bus.time_ns = at(1)
    rig.update(fix=fix(1))
    assert verdicts(rig.advance(1 + 19 * MS)) == []
    assert verdicts(rig.advance(1 + 20 * MS)) == [
        ("confirmed", "height_agrees")
    ]  # by the pose of the epoch before


def test_nor_where_the_fix_is_dated_ahead(rig):
    rig.epoch(0)
    rig.bus.time_ns = at(1)
    rig.update(fix=fix(3))
    assert verdicts(rig.advance(1)) == []
    assert len(verdicts(rig.advance(1 + 20 * MS))) == 1


def test_nor_where_the_clock_is_set_back(rig):
    rig.epoch(100)
    rig.update(fix=fix(101))
    rig.advance(99.9)
    assert rig.service._pending == []


def test_nor_where_there_is_no_localizer(rig):
    rig.bus.alive.discard("localizer")
    assert verdicts(rig.epoch(0, pose=None)) == [("unknown", "localizer_absent")]


def test_what_still_waits_at_the_end_is_judged(rig):
    rig.epoch(0)
    rig.bus.time_ns = at(1)
    rig.update(fix=fix(1))
    rig.advance(1)
    rig.service.close()
    assert verdicts(rig.take()) == [("confirmed", "height_agrees")]


def test_a_fix_that_the_judge_fails_on_is_not_tried_for_ever(rig, monkeypatch):
    rig.epoch(0)
    monkeypatch.setattr(rig.service._judge, "judge", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        rig.epoch(1)
    monkeypatch.undo()
    assert verdicts(rig.epoch(2)) == [("confirmed", "height_agrees")]


# --- silence -----------------------------------------------------------------------------------------------------

LIMIT_S = {
    "gnss": BY_NAME["fix"].max_age_s,
    "localizer": BY_NAME["pose"].max_age_s,
    "antenna_height": BY_NAME["antenna_height"].max_age_s,
    "map_server": 0.0,
}
INPUT = {"gnss": "fix", "localizer": "pose", "antenna_height": "antenna_height"}
GONE = {
    "gnss": {"gnss_absent"},
    "localizer": {"localizer_absent"},
    "antenna_height": {"antenna_height_absent"},
    "map_server": {"map_server_absent"},
}
FROZEN = GONE | {
    "gnss": {"gnss_stale"},
    "localizer": {"pose_stale"},
    "antenna_height": {"antenna_height_stale"},
}


def without_map(k):
    """What the localizer says when the map server does not answer."""
    return pose(k, road=road(status="unknown", reason="map_server_absent"))


@pytest.mark.parametrize("service", sorted(LIMIT_S))
@pytest.mark.parametrize(("token_stays", "reasons"), [(False, GONE), (True, FROZEN)], ids=["gone", "frozen"])
@pytest.mark.parametrize("step", [0.25, 0.5, 1.0], ids=["20 Hz", "10 Hz", "5 Hz"])
def test_without_a_service_the_verdict_is_unknown_within_the_age_limit(service, token_stays, reasons, step):
    rig = Rig()
    rig.epoch(0)
    if not token_stays:
        rig.bus.alive.discard(service)
    latest = []
    for n in range(1, round(16 / step)):
        k = n * step
        changes = {INPUT[service]: None} if service in INPUT else {"pose": without_map(k)}
        latest += [v for v in of(rig.epoch(k, **changes), "verdict") if v.time_ns > at(0)]
    limit_ns = at(0) + LIMIT_S[service] * 1e9
    late = [v for v in latest if v.time_ns > limit_ns + 1]
    assert late
    assert {(v.verdict, v.reason) for v in late} == {("unknown", reason) for reason in reasons[service]}
    assert late[0].time_ns <= limit_ns + max(0.1e9, step * 0.2e9) + 1
    gaps_s = [(b.time_ns - a.time_ns) / 1e9 for a, b in itertools.pairwise(late)]
    assert max(gaps_s) <= max(0.1, 0.2 * step) + 1e-6


@pytest.mark.parametrize("step", [0.25, 0.5, 1.0], ids=["20 Hz", "10 Hz", "5 Hz"])
def test_without_poses_the_position_is_none_however_often_fixes_come(step):
    rig = Rig()
    rig.epoch(0)
    sent = []
    for n in range(1, round(10 / step)):
        sent += [p for p in of(rig.epoch(n * step, pose=None), "position") if p.source == "none"]
    assert sent
    assert {(p.usable, p.reason) for p in sent} == {(False, "pose_stale")}
    assert sent[-1].time_ns >= at(10 - 2 * step)


def test_from_the_first_moment_there_is_a_verdict(rig):
    rig.bus.alive.clear()
    sent = rig.advance(0)
    assert verdicts(sent) == [("unknown", "gnss_absent")]
    assert [p.reason for p in of(sent, "position")] == ["localizer_absent"]
    assert of(sent, "verdict")[0].fix_id is None


def test_when_all_is_well_nothing_is_published_between_the_epochs(rig):
    rig.epoch(0)
    assert rig.advance(0.6) == []


def test_after_the_clock_was_set_back_there_is_no_silence(rig):
    rig.epoch(10_000)
    sent = rig.advance(0)
    assert verdicts(sent) == [("unknown", "gnss_stale")]
    assert [p.source for p in of(rig.epoch(1, fix=None), "position")] == ["sensors"]
    assert verdicts(rig.epoch(2)) == [("confirmed", "height_agrees")]


# --- uploads -----------------------------------------------------------------------------------------------------


def batches_in(folder):
    with closing(Outbox(folder / "outbox.sqlite", vehicle="vehicle", limit_bytes=1 << 20)) as outbox:
        waiting = outbox.pending(100)
    assert {upload.channel for upload in waiting} <= {"upload_batch"}
    return [decode(UploadBatch, upload.payload, None).message for upload in waiting]


def test_every_judged_fix_is_uploaded_once_in_batches_of_five_seconds(kept, tmp_path):
    for k in range(60):
        kept.epoch(k, fix=fix(k, up_m=1.0 if k % 7 == 0 else 0.0))
    kept.service.close()
    batches = batches_in(tmp_path / "state")
    assert [len(batch.surface_id) for batch in batches] == [25, 25, 10]
    assert [t for batch in batches for t in batch.positioning_time_ns] == [at(k) for k in range(60)]
    assert {int(v) for batch in batches for v in batch.verdict} == {0, 2}


def test_a_batch_goes_when_its_time_is_over_even_if_nothing_follows(kept, tmp_path):
    kept.epoch(0)
    kept.advance(25)
    assert kept.service._collector.take() is None
    kept.service.close()
    assert len(batches_in(tmp_path / "state")) == 1


def test_a_fix_that_says_nothing_of_a_road_is_not_uploaded(kept, tmp_path):
    kept.epoch(0, fix=fix(0, quality="float"))
    kept.epoch(1, fix=fix(1, north_m=5.0))
    kept.service.close()
    assert batches_in(tmp_path / "state") == []


@pytest.mark.parametrize("settings", [{"upload": False}, {}], ids=["switched off", "no state_dir"])
def test_without_uploads_there_is_no_outbox(tmp_path, settings):
    rig = Rig(**({"state_dir": tmp_path} | settings if settings else {}))
    rig.epoch(0)
    rig.service.close()
    assert not list(tmp_path.glob("outbox*"))


def test_what_hinders_the_uploads_is_an_issue(kept):
    kept.service._uploader._problems.put(("upload_not_stored", "no room"))
    kept.advance(0)
    assert kept.bus.issues["upload_not_stored"] == "no room"
    kept.service.close()


# --- the correction over a restart -------------------------------------------------------------------------------


def test_the_correction_survives_a_restart(kept, tmp_path):
    for k in range(80):
        kept.epoch(k, fix=fix(k, up_m=0.1))
    assert (tmp_path / "state" / "correction.json").exists()  # every 100 m: a kill loses little
    kept.service.close()
    (learnt,) = kept.service._judge.learning.parts
    assert learnt.correction.correction_m > 0.0
    again = Rig(state_dir=tmp_path / "state")
    assert [part.correction for part in again.service._judge.learning.parts] == [learnt.correction]
    again.service.close()


@pytest.mark.parametrize(
    "text", ["", '{"correction_m": 5.0, "samples": 1}', '{"correction_m": 0, "samples": 1e999}']
)
def test_a_damaged_correction_is_an_issue_and_none(tmp_path, text):
    (tmp_path / "correction.json").write_text(text)
    rig = Rig(state_dir=tmp_path, upload=False)
    assert rig.service._judge.learning.parts == ()
    assert str(tmp_path) in rig.bus.issues["state_rejected"]


def test_a_correction_that_cannot_be_saved_is_an_issue(tmp_path):
    rig = Rig(state_dir=tmp_path, upload=False)
    (tmp_path / "correction.json").mkdir()
    (tmp_path / "correction.json" / "file").write_text("in the way")
    for k in range(15):
        rig.epoch(k, fix=fix(k, up_m=0.1))
    rig.service.close()
    assert "correction.json" in rig.bus.issues["state_not_saved"]


def test_a_judge_that_learnt_nothing_writes_nothing(tmp_path):
    rig = Rig(state_dir=tmp_path, upload=False)
    rig.advance(0)
    rig.service.close()
    assert list(tmp_path.iterdir()) == []


# --- settings ----------------------------------------------------------------------------------------------------


def test_the_rules_are_those_of_the_settings():
    rules = IntegritySettings(
        tolerance="fixed", tolerance_m=0.3, start_gap_s=2.0, sigma_scale=2.0, series_vertical_m=0.2
    ).rules()
    assert rules.determination.largest_tolerance_m == 0.3
    assert rules.start.longest_gap_s == 2.0
    assert rules.true_sigma.scale == 2.0
    assert rules.series.vertical_m == 0.2


def test_the_ages_are_those_of_the_table_of_channels():
    rules = IntegritySettings().rules()
    assert rules.pose_max_age_s == BY_NAME["pose"].max_age_s
    assert rules.antenna_max_age_s == BY_NAME["antenna_height"].max_age_s
    assert rules.fix_max_age_s == BY_NAME["fix"].max_age_s
    assert rules.motion_max_age_s == BY_NAME["motion"].max_age_s
