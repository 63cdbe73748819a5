"""What has arrived and may be handed out: fresh, valid, in order; and why the rest may not."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from camber.runtime.single_producer import SampleOrigin, SingleProducer
from camber.schemas.base import Message
from camber.schemas.channels import Channel
from camber.schemas.codec import DecodeError, Received, decode

_FUTURE_LIMIT_NS = 500_000_000  # beyond this a sender's clock is wrong, not merely ahead
_SOURCES = 64  # whose last message is remembered: a peer that invents names must not fill the memory
_NS = 1_000_000_000  # nanoseconds of a second


@dataclass(slots=True, kw_only=True)
class Inbox:
    """Judges the messages of one channel; `refused` counts those that were not handed out, by reason.

    Reasons: `undecodable`, `stale` (older than the table allows), `future`, `repeated`, `out_of_order`, and on a
    vehicle's channels `two_producers` and `new_producer` (`single_producer`).
    """

    channel: Channel
    refused: Counter[str] = field(default_factory=Counter)
    last_detail: str = ""
    last_reason: str = ""
    _last: dict[tuple[str, str | None], tuple[int, int]] = field(default_factory=dict)
    _producer: SingleProducer | None = None

    def __post_init__(self) -> None:
        if "{vehicle}" in self.channel.key:
            self._producer = SingleProducer(rate_hz=self.channel.rate_hz)

    def open(self, data: bytes, encoding: str | None) -> Received[Any] | None:
        """Decode, or count and return None."""
        try:
            return decode(self.channel.message, data, encoding)
        except DecodeError as error:
            self._refuse("undecodable", str(error))
            return None

    def accept(
        self,
        received: Received[Any],
        now_ns: int,
        *,
        judge_age: bool = True,
        arrival: SampleOrigin | None = None,
    ) -> Message | None:
        """Return the message if it is fresh, new and of the only producer, else count why not.

        A sequence that begins anew with a later time is a producer that was restarted. Without `arrival`, as in a
        replay, producers are not judged.
        """
        message: Message = received.message
        source, sequence = received.source, received.sequence
        key = (source, None if arrival is None else arrival.session)
        if judge_age and self.channel.max_age_s is not None:
            age_ns = now_ns - message.time_ns
            if age_ns > self.channel.max_age_s * _NS:
                return self._refuse("stale", f"{age_ns / _NS:.3f} s old, at most {self.channel.max_age_s} s")
            if age_ns < -_FUTURE_LIMIT_NS:
                return self._refuse("future", f"{-age_ns / _NS:.3f} s in the future")
        last_sequence, last_time_ns = self._last.get(key, (-1, 0))
        if judge_age and last_time_ns - now_ns > _FUTURE_LIMIT_NS:  # since then the clock was set back
            last_sequence, last_time_ns = -1, 0
        if sequence == last_sequence and message.time_ns == last_time_ns:
            return self._refuse("repeated", f"number {sequence} came twice")
        if sequence <= last_sequence and message.time_ns <= last_time_ns:
            return self._refuse("out_of_order", f"number {sequence} after {last_sequence}")
        problem = None
        if arrival is not None and self._producer is not None:
            problem = self._producer.problem(source, sequence, arrival)
        if problem is not None:
            return self._refuse(problem, f"{self._producer}; expected one")
        self._last.pop(key, None)
        self._last[key] = (sequence, message.time_ns)
        if len(self._last) > _SOURCES:
            del self._last[next(iter(self._last))]  # who has been silent for longest
        return message

    def _refuse(self, reason: str, detail: str) -> Message | None:
        self.refused[reason] += 1
        self.last_reason, self.last_detail = reason, detail
        return None
