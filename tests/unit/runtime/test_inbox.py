"""An inbox hands out what is fresh, valid and new, and counts why the rest is not."""

from __future__ import annotations

import pytest

from camber.runtime.inbox import Inbox
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import Received, encode, encoding_of
from camber.schemas.gnss import ReceiverBytes
from camber.schemas.motion import Motion, Suspension

NS = 1_000_000_000
NOW_NS = 1_300_000_000 * NS
MOTION = BY_NAME["motion"]
assert MOTION.max_age_s == 0.5


def received(sequence: int, at_s: float = 0.0, source: str = "vehicle") -> Received[Motion]:
    motion = Motion(time_ns=NOW_NS + round(at_s * NS), wheel_speed_m_s=1.0)
    return Received(message=motion, source=source, sequence=sequence)


def accepts(inbox: Inbox, message: Received[Motion], now_s: float = 0.0) -> bool:
    return inbox.accept(message, NOW_NS + round(now_s * NS)) is message.message


# Messages in order: number, time in s, whether it is handed out; then why the others are not.
CASES: dict[str, tuple[list[tuple[int, float, bool]], dict[str, int]]] = {
    "a fresh message": ([(0, 0.0, True)], {}),
    "as old as the table allows, and older": ([(0, -0.5, True), (1, -0.501, False)], {"stale": 1}),
    "a clock a little ahead, and one far ahead": ([(0, 0.5, True), (1, 0.501, False)], {"future": 1}),
    "a refused message leaves no trace": (
        [(90, 60.0, False), (80, -60.0, False), (0, 0.0, True)],
        {"future": 1, "stale": 1},
    ),
    "twice": ([(7, 0.0, True), (7, 0.0, False)], {"repeated": 1}),
    "an older number, or an older time": (
        [(7, 0.0, True), (6, -0.1, False), (6, 0.0, False), (7, -0.1, False)],
        {"out_of_order": 3},
    ),
    "gaps in the numbers": ([(0, 0.0, True), (3, 0.03, True), (17, 0.17, True)], {}),
    # The last is what the predecessor of a restarted producer, or the network, repeats.
    "a restarted producer": (
        [(500, 0.0, True), (0, 0.1, True), (1, 0.2, True), (0, 0.1, False)],
        {"out_of_order": 1},
    ),
    "a producer restarted after its first message": ([(0, 0.0, True), (0, 0.1, True)], {}),
}


def test_the_localizer_takes_each_sample_of_the_motion_however_late_it_has_made_them() -> None:
    inbox, others = (Inbox(channel=MOTION.received_by(name)) for name in ("localizer", "integrity"))
    assert accepts(inbox, received(0, at_s=-5.0))
    assert not accepts(inbox, received(1, at_s=-5.01))
    assert not accepts(others, received(0, at_s=-0.6))


@pytest.mark.parametrize(("messages", "refused"), CASES.values(), ids=CASES)
def test_what_is_fresh_and_new_is_handed_out(
    messages: list[tuple[int, float, bool]], refused: dict[str, int]
) -> None:
    inbox = Inbox(channel=MOTION)
    for sequence, at_s, accepted in messages:
        assert accepts(inbox, received(sequence, at_s=at_s)) == accepted
    assert inbox.refused == refused


def test_what_is_stale_is_named_with_its_age() -> None:
    inbox = Inbox(channel=MOTION)
    assert not accepts(inbox, received(1, at_s=-0.501))
    assert inbox.last_detail == "0.501 s old, at most 0.5 s"


def test_a_producer_restarted_while_the_clock_was_set_back_is_accepted() -> None:
    inbox = Inbox(channel=MOTION)
    assert accepts(inbox, received(90, at_s=3600.0), now_s=3600.0)
    assert accepts(inbox, received(0, at_s=1.0), now_s=1.0)
    assert not accepts(inbox, received(0, at_s=1.0), now_s=1.0)


def test_sources_are_distinguished() -> None:
    inbox = Inbox(channel=MOTION)
    assert accepts(inbox, received(7))
    assert accepts(inbox, received(3, at_s=-0.1, source="other"))
    assert not accepts(inbox, received(7))


def test_invented_source_names_do_not_fill_the_memory_nor_bring_old_messages_back() -> None:
    inbox = Inbox(channel=MOTION)
    for n in range(5000):
        assert accepts(inbox, received(n, at_s=n / 1e5, source="vehicle"))
        assert accepts(inbox, received(0, source=f"liar-{n}"))
        assert not accepts(inbox, received(n, at_s=n / 1e5, source="vehicle"))
    assert len(inbox._last) <= 64


def test_in_a_replay_age_is_not_judged_but_order_is() -> None:
    inbox = Inbox(channel=MOTION)
    old = received(4, at_s=-3600.0)
    assert inbox.accept(old, NOW_NS, judge_age=False) is old.message
    assert inbox.accept(old, NOW_NS, judge_age=False) is None
    assert inbox.refused == {"repeated": 1}


def test_a_channel_without_an_age_limit_takes_any_age() -> None:
    inbox = Inbox(channel=BY_NAME["release"])
    assert BY_NAME["release"].max_age_s is None
    assert inbox.accept(received(0, at_s=-1e6), NOW_NS) is not None


def test_what_cannot_be_decoded_is_counted_and_named() -> None:
    inbox = Inbox(channel=MOTION)
    good = encode(received(3).message, source="vehicle", sequence=3)
    opened = inbox.open(good, encoding_of(Motion))
    assert (opened.source, opened.sequence) == ("vehicle", 3)
    suspension = Suspension(time_ns=NOW_NS, stroke_height_m=0.2, stroke_sigma_m=0.01)
    for data, encoding in (
        (b"", encoding_of(Motion)),
        (good[:-1], encoding_of(Motion)),
        (good, encoding_of(ReceiverBytes)),
        (encode(suspension), encoding_of(Motion)),
    ):
        inbox.last_detail = ""
        assert inbox.open(data, encoding) is None
        assert inbox.last_detail
    assert inbox.refused == {"undecodable": 4}
