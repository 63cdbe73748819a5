"""One producer for each channel of a vehicle: while two publish, neither is used.

Which of the two is the right one cannot be known. The first may be a process that was forgotten, the second the one
that was meant; to use the earlier one would be to report *trusted* on a guess. So both are refused until one has been
silent for `SUCCESSION_S`; *unknown* follows as for an absent producer. A newcomer waits for as long, for one message of
its would be enough to confirm a wrong fix. Against a forged identity of a session only access rules help.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

SUCCESSION_S = 2.0
"""Chosen: a service takes as long to start again, and publishes twice a second or more where its channel has a rate."""
_SLOWEST_PERIODS = 2.5  # chosen: of a channel with a lower rate, so that one lost message is no silence
_SHOWN = 8  # chosen: digits of a session's identifier, enough to distinguish two


class SampleOrigin(NamedTuple):
    """Of a message: the Zenoh session it is from, None where its publisher does not say, and the time, monotonic."""

    session: str | None
    at_ns: int


class Producer(NamedTuple):
    """Who publishes: the name in the message, its session, and how often its numbers have begun anew."""

    source: str
    session: str | None
    run: int

    def __str__(self) -> str:
        return f"{self.source[:64]} in session {(self.session or 'not named')[:_SHOWN]}"


class _Seen(NamedTuple):
    """A producer, and when its newest message came."""

    producer: Producer
    at_ns: int


ProducerProblem = Literal["two_producers", "new_producer"]


@dataclass(slots=True, kw_only=True)
class SingleProducer:
    """Decides on each message of a channel, in order of arrival, whether its producer is the only one."""

    rate_hz: float | None
    _used: Producer | None = None
    _sequence: int = -1  # of the one used
    _newest: _Seen | None = None
    _other: _Seen | None = None  # the newest of all others
    _disputed: bool = False

    def problem(self, source: str, sequence: int, arrival: SampleOrigin) -> ProducerProblem | None:
        """Return None for the only producer, else why its message is not used.

        `new_producer`: another one published shortly before. `two_producers`: and it has published since.
        """
        producer = self._producer(source, sequence, arrival.session)
        before, self._newest = self._newest, _Seen(producer, arrival.at_ns)
        if before is not None and before.producer != producer:
            self._disputed |= self._is_active(self._other, arrival.at_ns) and self._other_is(producer)
            self._other = before
        if self._is_active(self._other, arrival.at_ns):
            return "two_producers" if self._disputed else "new_producer"
        self._used, self._sequence = producer, sequence
        self._other, self._disputed = None, False
        return None

    def __str__(self) -> str:
        """The newest producer and the other one."""
        seen = (self._newest, self._other)
        return " and ".join(str(each.producer) for each in seen if each is not None)

    def _producer(self, source: str, sequence: int, session: str | None) -> Producer:
        """Numbers that fall are those of another process, or of one that was started again."""
        used = self._used
        if used is None or used[:2] != (source, session):
            return Producer(source, session, 0)
        if sequence < self._sequence:
            return used._replace(run=used.run + 1)
        self._sequence = sequence
        return used

    def _other_is(self, producer: Producer) -> bool:
        return self._other is not None and self._other.producer == producer

    def _is_active(self, seen: _Seen | None, now_ns: int) -> bool:
        slow_s = 0.0 if self.rate_hz is None else _SLOWEST_PERIODS / self.rate_hz
        return seen is not None and now_ns - seen.at_ns < max(SUCCESSION_S, slow_s) * 1e9
