"""The judge's process asks gnss for other estimates: one final verdict a fix, whatever gnss answers or does not."""

from collections import Counter

import pytest

from camber.integrity.service import IntegrityService
from camber.integrity.settings import IntegritySettings
from camber.runtime.bus import QueryFailed
from camber.schemas.gnss import Estimates
from camber.schemas.motion import Motion
from support.judging import ALL, antenna, at, candidate, fix, pose, provisional


class BusWithGnss:
    """A bus on which gnss gives the answers of the test, after the time of the test."""

    def __init__(self):
        self.time_ns = at(0)
        self.sent, self.asked, self.issues, self.counters = [], [], {}, Counter()
        self.answer = lambda request: available(request)
        self.takes_ns = 0

    def now_ns(self):
        return self.time_ns

    def is_alive(self, service):
        return service in ALL

    def publish(self, name, message):
        self.sent.append((name, message))

    def issue(self, code, text):
        self.issues[code] = text

    def count(self, name, n=1):
        self.counters[name] += n

    def ask(self, name, request):
        assert name == "estimates"
        self.asked.append(request)
        self.time_ns += self.takes_ns
        return self.answer(request)


def available(request, **changes):
    """Three estimates that agree and are right."""
    epoch = (request.time_ns - at(0)) / (at(1) - at(0))
    result = [candidate(epoch, east_m=0.01 * k, excluded=(f"G{k:02d}",)) for k in range(1, 4)]
    fields = {"status": "available", "trials": request.maximum_trials, "candidates": tuple(result)}
    return Estimates(time_ns=request.time_ns, fix_id=request.fix_id, **fields | changes)


def failing(reason):
    def answer(_):
        raise QueryFailed(reason, "as given")

    return answer


class Rig:
    def __init__(self, **settings):
        self.bus = BusWithGnss()
        self.service = IntegrityService(IntegritySettings(**settings), self.bus)
        self.handlers = self.service.handlers()

    def epoch(self, k, **changes):
        """An epoch of which the engine's fix is a metre too high, and everything else is right."""
        self.bus.time_ns = at(k)
        messages = {
            "motion": Motion(time_ns=at(k), wheel_speed_m_s=10.0),
            "antenna_height": antenna(k),
            "pose": pose(k),
            "fix": fix(k, up_m=1.0, origin="engine"),
        } | changes
        for name, message in messages.items():
            self.handlers[name](message)
        self.service.advance(at(k))
        sent, self.bus.sent = self.bus.sent, []
        return sent


def verdict_in(sent):
    (verdict,) = [message for name, message in sent if name == "verdict"]
    return verdict


@pytest.mark.parametrize("quality", ["fixed", "float"])
def test_another_estimate_that_passes_is_the_position_of_the_epoch(quality):
    rig = Rig()
    sent = rig.epoch(0, fix=fix(0, up_m=1.0, origin="engine", quality=quality))
    verdict = verdict_in(sent)
    assert (verdict.verdict, verdict.reason, verdict.trials) == ("confirmed", "height_agrees", 21)
    assert "estimates" in verdict.evidence
    assert verdict.fix_id == fix(0).fix_id
    assert verdict.height_m == candidate(0).height_m
    (position,) = [message for name, message in sent if name == "position"]
    assert (position.source, position.height_m) == ("rtk", candidate(0).height_m)
    assert rig.bus.counters["estimates.confirmed"] == 1


def test_a_right_fix_is_not_asked_about():
    rig = Rig()
    assert verdict_in(rig.epoch(0, fix=fix(0, origin="engine"))).trials == 1
    assert rig.bus.asked == []


@pytest.mark.parametrize("status", ["unavailable", "forgotten"])
def test_without_estimates_the_verdict_is_that_of_the_fix(status):
    rig = Rig()
    rig.bus.answer = lambda request: available(
        request, status=status, trials=0, candidates=(), reason="no rows"
    )
    verdict = verdict_in(rig.epoch(0))
    assert (verdict.verdict, verdict.reason, verdict.trials) == ("erroneous", "height_disagrees", 1)
    assert verdict.detail.endswith("; no other estimates: no rows")


@pytest.mark.parametrize("reason", ["absent", "timeout", "refused", "invalid"])
def test_where_gnss_fails_so_does_the_fix_and_nothing_else(reason):
    rig = Rig()
    rig.bus.answer = failing(reason)
    verdict = verdict_in(rig.epoch(0))
    assert (verdict.verdict, verdict.reason) == ("erroneous", "height_disagrees")
    assert verdict.detail.endswith(f"no other estimates: {reason}: as given")
    assert rig.bus.counters[f"estimates.{reason}"] == 1


def test_a_gnss_that_hangs_is_waited_for_once_in_two_seconds():
    rig = Rig()
    rig.bus.answer, rig.bus.takes_ns = failing("timeout"), 100_000_000
    verdicts = [verdict_in(rig.epoch(k)) for k in range(40)]
    assert len(rig.bus.asked) == 4
    assert {v.verdict for v in verdicts} == {"erroneous"}
    assert sum("just not answered" in v.detail for v in verdicts) == 36


def test_one_that_is_absent_is_asked_as_soon_as_it_is_back():
    rig = Rig()
    rig.bus.answer = failing("absent")
    rig.epoch(0)
    rig.bus.answer = available
    assert verdict_in(rig.epoch(1)).verdict == "confirmed"


@pytest.mark.parametrize(
    "changes",
    [{"pose": provisional(0)}, {"pose": pose(0, mode="none")}, {"antenna_height": antenna(-50)}],
    ids=["provisional", "no pose", "stale antenna"],
)
@pytest.mark.parametrize("quality", ["fixed", "float"])
def test_where_no_estimate_could_be_judged_none_is_asked_for(changes, quality):
    rig = Rig()
    verdict_in(rig.epoch(0, fix=fix(0, up_m=1.0, origin="engine", quality=quality), **changes))
    assert rig.bus.asked == []


def test_what_is_asked_and_what_agrees_is_set():
    rig = Rig(most_trials=5, agreement_ambiguities=11)
    verdict = verdict_in(rig.epoch(0))
    assert [request.maximum_trials for request in rig.bus.asked] == [5]
    assert (verdict.verdict, verdict.trials) == ("erroneous", 6)
    assert "10 ambiguities" in verdict.detail
    rules = IntegritySettings(agreement_m=0.2, agreement_success=(0.9,)).rules().re_estimation.agreement
    assert (rules.distance_m, rules.success) == (0.2, (0.9,))


@pytest.mark.parametrize(
    ("settings", "quality", "asks"),
    [
        ({"re_estimation": "off"}, "fixed", 0),
        ({"re_estimation": "one_by_one"}, "fixed", 1),
        ({"re_estimate_unresolved": False}, "fixed", 1),
        ({"re_estimate_unresolved": False}, "float", 0),
    ],
)
def test_it_can_be_switched_off_or_be_the_documents(settings, quality, asks):
    rig = Rig(**settings)
    rig.epoch(0, fix=fix(0, up_m=1.0, origin="engine", quality=quality))
    assert len(rig.bus.asked) == asks
