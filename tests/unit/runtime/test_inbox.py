"""An inbox hands out what is fresh, valid and new, and counts why the rest is not."""

from __future__ import annotations

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


def test_a_fresh_message_is_handed_out() -> None:
    inbox = Inbox(channel=MOTION)
    assert accepts(inbox, received(0))
    assert not inbox.refused


def test_what_is_older_than_the_table_allows_is_stale() -> None:
    inbox = Inbox(channel=MOTION)
    assert accepts(inbox, received(0, at_s=-0.5))
    assert not accepts(inbox, received(1, at_s=-0.501))
    assert inbox.refused == {"stale": 1}
    assert inbox.last_detail == "0.501 s old, at most 0.5 s"


def test_a_clock_a_little_ahead_is_borne_and_one_far_ahead_is_not() -> None:
    inbox = Inbox(channel=MOTION)
    assert accepts(inbox, received(0, at_s=0.5))
    assert not accepts(inbox, received(1, at_s=0.501))
    assert inbox.refused == {"future": 1}


def test_a_refused_message_leaves_no_trace() -> None:
    inbox = Inbox(channel=MOTION)
    assert not accepts(inbox, received(90, at_s=60.0))
    assert not accepts(inbox, received(80, at_s=-60.0))
    assert accepts(inbox, received(0))


def test_a_message_that_comes_twice_is_handed_out_once() -> None:
    inbox = Inbox(channel=MOTION)
    assert accepts(inbox, received(7))
    assert not accepts(inbox, received(7))
    assert inbox.refused == {"repeated": 1}


def test_an_older_number_with_an_older_time_is_out_of_order() -> None:
    inbox = Inbox(channel=MOTION)
    assert accepts(inbox, received(7))
    assert not accepts(inbox, received(6, at_s=-0.1))
    assert not accepts(inbox, received(6))
    assert not accepts(inbox, received(7, at_s=-0.1))
    assert inbox.refused == {"out_of_order": 3}


def test_gaps_in_the_numbers_are_no_fault() -> None:
    inbox = Inbox(channel=MOTION)
    assert [accepts(inbox, received(n, at_s=n / 100)) for n in (0, 3, 17)] == [True] * 3


def test_a_restarted_producer_counts_from_zero_and_is_accepted_at_once() -> None:
    inbox = Inbox(channel=MOTION)
    assert accepts(inbox, received(500))
    assert accepts(inbox, received(0, at_s=0.1))
    assert accepts(inbox, received(1, at_s=0.2))
    assert not accepts(inbox, received(0, at_s=0.1))  # what its predecessor or the network repeats
    assert inbox.refused == {"out_of_order": 1}


def test_a_producer_restarted_after_its_first_message_is_accepted() -> None:
    inbox = Inbox(channel=MOTION)
    assert accepts(inbox, received(0))
    assert accepts(inbox, received(0, at_s=0.1))


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
    assert opened is not None
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
