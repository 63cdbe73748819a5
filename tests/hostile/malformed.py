"""What a hostile peer says on the channels of a vehicle: nothing that anybody may take for a message that counts.

Everything here is refused by its decoder, or for its age: that is checked when it is made. Each kind goes to
every channel that a service subscribes to and to every question that one answers.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from random import Random
from typing import Any

import msgpack

from camber.runtime.inbox import Inbox
from camber.schemas.channels import CHANNELS, SERVICES, Channel
from camber.schemas.codec import DecodeError, decode, encode, encoding_of
from fuzz.mutation import damaged
from support.messages import build, message_classes

LARGE_BYTES = 2_000_000
Make = Callable[[Random, Channel, int], bytes]
_YEAR_NS = 365 * 86_400 * 1_000_000_000


@dataclass(frozen=True)
class Malformed:
    """Bytes for a key; `asks`: as a question."""

    kind: str
    key: str
    payload: bytes
    encoding: str
    asks: bool


def channels(*, replayed: bool = False) -> tuple[Channel, ...]:
    """Whatever a service subscribes to or answers; in a replay the barrier's too."""
    consumed = (channel for channel in CHANNELS if set(channel.consumers) & set(SERVICES))
    return tuple(channel for channel in consumed if replayed or channel.delivery != "barrier")


def malformed(
    vehicle: str, now_ns: int, seed: int, *, of_each: int = 4, replayed: bool = False
) -> Iterator[Malformed]:
    """Of every kind some for every channel. `now_ns`: messages that are well-formed are years from it.

    In a replay no age is judged, and nothing well-formed is published.
    """
    random = Random(seed)
    for channel in channels(replayed=replayed):
        for service in [name for name in channel.consumers if name in SERVICES]:
            key = channel.key_for(vehicle).replace("{service}", service)
            for kind, make in _KINDS.items():
                if replayed and kind in _WELL_FORMED:
                    continue
                for _ in range(1 if kind.endswith("large") else of_each):
                    payload, encoding = make(random, channel, now_ns), _encoding(kind, random, channel)
                    _check(channel, kind, payload, encoding, now_ns)
                    yield Malformed(kind, key, payload, encoding, channel.reply is not None)
            if "{service}" not in channel.key:
                break


def _check(channel: Channel, kind: str, payload: bytes, encoding: str, now_ns: int) -> None:
    inbox = Inbox(channel=channel)
    received = inbox.open(payload, encoding)
    taken = received is not None and (channel.reply is not None or inbox.accept(received, now_ns) is not None)
    assert not taken, f"{kind} on {channel.name}: it is none"


def _valid(random: Random, channel: Channel) -> bytes:
    return encode(
        build(channel.message, random), source=random.choice(("vehicle", "gnss", "peer")), sequence=1
    )


def _wrong_schema(random: Random, channel: Channel, now_ns: int) -> bytes:
    """Another message under this one's encoding."""
    other = random.choice([cls for cls in message_classes() if cls is not channel.message])
    return encode(build(other, random), source="vehicle", sequence=1)


def _truncated(random: Random, channel: Channel, now_ns: int) -> bytes:
    payload = _valid(random, channel)
    return payload[: random.randrange(1, len(payload))]


def _damaged(random: Random, channel: Channel, now_ns: int) -> bytes:
    while True:
        payload = damaged(random, _valid(random, channel), [_valid(random, channel)])
        if not _decodes(channel, payload):
            return payload


def _with_header(header: bytes) -> bytes:
    return struct.pack("<I", len(header)) + header


def _packed(random: Random, channel: Channel, values: dict[str, Any]) -> bytes:
    """A message of these values, which nobody has checked."""
    sequence = random.randrange(1 << 30)
    return _with_header(msgpack.packb([channel.message.schema_name(), "vehicle", sequence, values]))


def _claims(random: Random, channel: Channel, now_ns: int) -> bytes:
    """Lengths of gigabytes, and nothing behind them."""
    shape = struct.pack("<II", 2**31 - 1, 2**31 - 1)
    return _packed(random, channel, {"time_ns": now_ns, "x": msgpack.ExtType(1, b"<f8" + shape)})


def _values(*replacements: object) -> Make:
    """Right schema and time, and values in it that nothing can have."""

    def make(random: Random, channel: Channel, now_ns: int) -> bytes:
        message = build(channel.message, random, filled=True)
        plain = {
            name: random.choice(replacements) if isinstance(value, float | int | tuple | str) else None
            for name, value in message.__dict__.items()
        }
        plain["time_ns"] = now_ns if len(plain) > 1 else random.choice((-1, 1 << 63, None, "now"))
        return _packed(random, channel, plain)

    return make


def _unknown_field(random: Random, channel: Channel, now_ns: int) -> bytes:
    return _packed(random, channel, {"time_ns": now_ns, f"field{random.randrange(1000)}": 1.0})


def _dated(years: float) -> Make:
    """Well-formed, years old or yet to come; as a question, which has no age, damaged beside."""

    def make(random: Random, channel: Channel, now_ns: int) -> bytes:
        if channel.reply is not None or channel.max_age_s is None:
            return _damaged(random, channel, now_ns)
        time_ns = now_ns + round(years * _YEAR_NS)
        message = build(channel.message, random).model_copy(update={"time_ns": time_ns})
        return encode(message, source="vehicle", sequence=random.randrange(1 << 30))

    return make


def _encoding(kind: str, random: Random, channel: Channel) -> str:
    if kind == "wrong encoding":
        return random.choice(("zenoh/bytes", "text/plain", "application/msgpack"))
    right = encoding_of(channel.message)
    return f"{right.rpartition('.v')[0]}.v99" if kind == "another version" else right


def _decodes(channel: Channel, payload: bytes) -> bool:
    try:
        decode(channel.message, payload)
    except DecodeError:
        return False
    return True


_KINDS: dict[str, Make] = {
    "random bytes": lambda random, channel, now_ns: random.randbytes(random.choice((1, 20, 300))),
    "empty": lambda random, channel, now_ns: b"",
    "wrong encoding": lambda random, channel, now_ns: _valid(random, channel),
    "another version": lambda random, channel, now_ns: _valid(random, channel),
    "another schema": _wrong_schema,
    "truncated": _truncated,
    "damaged": _damaged,
    "lengths of gigabytes": _claims,
    "not a number": _values(float("nan")),
    "infinite": _values(float("inf"), float("-inf")),
    "beyond any range": _values(1e300, -1e300, 1 << 63, -(1 << 63), "x" * 5000),
    "unknown field": _unknown_field,
    "years old": _dated(-3.0),
    "years ahead": _dated(3.0),
    "deep": lambda random, channel, now_ns: _with_header(b"\x91" * 30_000 + b"\xc0"),
    "large": lambda random, channel, now_ns: random.randbytes(LARGE_BYTES // 8) * 8,
}
_WELL_FORMED = ("years old", "years ahead")
