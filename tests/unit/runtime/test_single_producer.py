"""While two producers publish on a channel, neither is used; a newcomer waits until the other one is silent."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from camber.runtime.inbox import Inbox
from camber.runtime.single_producer import SUCCESSION_S, SampleOrigin, SingleProducer
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import Received
from camber.schemas.motion import Motion

NS = 1_000_000_000


class Channel:
    """One channel of 10 Hz, and what its consumer makes of each message."""

    def __init__(self, rate_hz: float | None = 10.0) -> None:
        self.producers = SingleProducer(rate_hz=rate_hz)
        self.sequences: dict[str | None, int] = {}

    def says(
        self, at_s: float, session: str | None, *, source: str = "localizer", sequence: int | None = None
    ) -> str:
        if sequence is None:
            sequence = self.sequences.get(session, -1) + 1
        self.sequences[session] = sequence
        return self.producers.problem(source, sequence, SampleOrigin(session, round(at_s * NS))) or "used"


def test_one_producer_is_used_from_its_first_message_on() -> None:
    channel = Channel()
    assert {channel.says(0.1 * k, "a") for k in range(100)} == {"used"}
    assert channel.says(1000.0, "a") == "used"


def test_no_message_of_a_second_one_is_ever_used_and_none_of_the_first_while_it_publishes() -> None:
    channel = Channel()
    assert channel.says(0.0, "a") == "used"
    assert channel.says(0.05, "b") == "new_producer"
    assert channel.says(0.1, "a") == "two_producers"
    for k in range(2, 100):
        assert channel.says(0.1 * k + 0.05, "b") == "two_producers"
        assert channel.says(0.1 * k + 0.1, "a") == "two_producers"
    assert channel.says(10.05 + SUCCESSION_S, "a") == "used"


def test_one_that_was_started_again_is_used_when_its_predecessor_has_been_silent() -> None:
    channel = Channel()
    assert channel.says(0.0, "a") == "used"
    assert channel.says(1.9, "b") == "new_producer"
    assert channel.says(2.0, "b") == "used"
    assert channel.says(2.1, "b") == "used"


def test_numbers_that_fall_in_one_session_are_those_of_a_second_producer() -> None:
    channel = Channel()
    assert channel.says(0.0, None, sequence=100) == "used"
    assert channel.says(0.1, None, sequence=5) == "new_producer"
    assert channel.says(0.2, None, sequence=101) == "two_producers"
    assert channel.says(0.3, None, sequence=6) == "two_producers"
    assert channel.says(2.3, None, sequence=7) == "used"


def test_two_names_in_one_session_are_two_producers() -> None:
    channel = Channel()
    assert channel.says(0.0, "a", source="sensors") == "used"
    assert channel.says(0.1, "a", source="ros2") == "new_producer"


def test_on_a_slow_channel_the_silence_is_longer() -> None:
    channel = Channel(rate_hz=1.0)
    assert channel.says(0.0, "a") == "used"
    assert channel.says(2.1, "b") == "new_producer"
    assert channel.says(2.5, "b") == "used"


@settings(derandomize=True, max_examples=300)
@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0.01, 1.9)), max_size=60))
def test_a_message_is_used_exactly_where_all_others_have_been_silent(
    messages: list[tuple[str, float]],
) -> None:
    channel, now_s = Channel(), 0.0
    last_s: dict[str, float] = {}
    for session, step_s in messages:
        now_s = round(now_s + step_s, 3)
        others = [at_s for name, at_s in last_s.items() if name != session and now_s - at_s < SUCCESSION_S]
        assert (channel.says(now_s, session) == "used") == (not others)
        last_s[session] = now_s


def received(sequence: int, source: str = "vehicle") -> Received[Motion]:
    return Received(message=Motion(time_ns=1_300_000_000 * NS + sequence), source=source, sequence=sequence)


def test_an_inbox_names_both_sessions_and_counts_why() -> None:
    inbox = Inbox(channel=BY_NAME["motion"])
    now_ns = 1_300_000_000 * NS
    assert inbox.accept(received(0), now_ns, arrival=SampleOrigin("a" * 32, 0)) is not None
    assert inbox.accept(received(9), now_ns, arrival=SampleOrigin("b" * 32, 1)) is None
    assert inbox.accept(received(1), now_ns, arrival=SampleOrigin("a" * 32, 2)) is None
    assert inbox.last_reason == "two_producers"
    assert inbox.last_detail == ("vehicle in session aaaaaaaa and vehicle in session bbbbbbbb; expected one")
    assert inbox.refused == {"new_producer": 1, "two_producers": 1}


def test_what_is_refused_for_its_age_disturbs_no_producer() -> None:
    inbox = Inbox(channel=BY_NAME["motion"])
    now_ns = 1_300_000_000 * NS
    assert inbox.accept(received(0), now_ns, arrival=SampleOrigin("a", 0)) is not None
    assert inbox.accept(received(0), now_ns + 60 * NS, arrival=SampleOrigin("b", 1)) is None
    assert inbox.accept(received(1), now_ns, arrival=SampleOrigin("a", 2)) is not None


def test_workers_of_the_fleet_may_publish_on_one_channel() -> None:
    inbox = Inbox(channel=BY_NAME["release"])
    for session in "abab":
        assert inbox.accept(received(len(inbox._last)), 0, arrival=SampleOrigin(session, 0)) is not None
        inbox._last.clear()
