"""The receiver's warnings hold a fix back as long as they are fresh; what it does not know changes nothing."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.checks.receiver_integrity import ReceiverIntegrityMonitor
from camber.schemas.gnss import ReceiverIntegrity
from support.judging import at

MAX_AGE_S = 2.0


def monitor_of(*statements):
    verdict = ReceiverIntegrityMonitor()
    for epoch, fields in statements:
        verdict.update(ReceiverIntegrity(time_ns=at(epoch), **fields))
    return verdict


def warning(verdict, epoch=0):
    return verdict.warning(at(epoch), MAX_AGE_S)


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"spoofing": "indicated"}, "spoofing indicated"),
        ({"spoofing": "affirmed"}, "spoofing affirmed"),
        ({"jamming": "critical"}, "jamming critical"),
        ({"raim": "failed"}, "raim failed"),
        ({"raim": "failed", "spoofing": "affirmed"}, "spoofing affirmed, raim failed"),
    ],
)
def test_it_warns_of(fields, expected):
    assert warning(monitor_of((0, fields))) == expected


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"spoofing": "none", "jamming": "none", "raim": "passed"},
        {"jamming": "warning"},
        {"fix_within_masks": "no", "authenticated": "no"},
    ],
)
def test_it_does_not_warn_of(fields):
    assert warning(monitor_of((0, fields))) is None


def test_without_a_message_there_is_no_warning():
    assert warning(ReceiverIntegrityMonitor()) is None


def test_what_is_not_known_takes_nothing_back_but_good_news_does():
    assert warning(monitor_of((0, {"spoofing": "affirmed"}), (1, {}))) == "spoofing affirmed"
    assert warning(monitor_of((0, {"spoofing": "affirmed"}), (1, {"spoofing": "none"}))) is None
    assert warning(monitor_of((0, {"spoofing": "affirmed"}), (1, {"jamming": "none"}))) == "spoofing affirmed"


def test_of_two_of_one_time_the_later_received_counts():
    assert warning(monitor_of((0, {"raim": "failed"}), (0, {"raim": "passed"}))) is None


def test_what_comes_late_does_not_replace_what_is_newer():
    assert warning(monitor_of((1, {"raim": "failed"}), (0, {"raim": "passed"}))) == "raim failed"


@pytest.mark.parametrize(
    ("epoch", "expected"), [(10, "raim failed"), (-10, "raim failed"), (11, None), (-11, None)]
)
def test_it_holds_as_long_as_its_age_allows(epoch, expected):
    assert warning(monitor_of((0, {"raim": "failed"})), epoch) == expected


def test_what_is_dated_ahead_is_forgotten_when_the_clock_is_set_back():
    verdict = monitor_of((0, {"raim": "failed"}), (5, {"spoofing": "affirmed"}))
    verdict.forget_after(at(4))
    assert warning(verdict) == "raim failed"
    verdict.forget_after(at(0))
    assert warning(verdict) == "raim failed"


@settings(deadline=None, derandomize=True)
@given(
    st.lists(
        st.tuples(st.integers(-20, 20), st.sampled_from(["none", "indicated", "affirmed", "unknown"])),
        max_size=8,
    )
)
def test_the_newest_known_state_counts(statements):
    verdict = monitor_of(*((epoch, {"spoofing": spoofing}) for epoch, spoofing in statements))
    known = [s for s in statements if s[1] != "unknown"]
    newest = max(known, key=lambda s: (s[0], known.index(s)), default=None)
    newest = next((s for s in reversed(known) if newest is not None and s[0] == newest[0]), None)
    expected = (
        f"spoofing {newest[1]}"
        if newest is not None and newest[1] != "none" and abs(newest[0]) <= 10
        else None
    )
    assert warning(verdict) == expected
