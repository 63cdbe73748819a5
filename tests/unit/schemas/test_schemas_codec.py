"""Bytes and messages: what goes out comes back, and whatever else comes in is refused in one way."""

from __future__ import annotations

import struct
from random import Random
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.schemas.base import Message
from camber.schemas.codec import DecodeError, decode, encode, encoding_of
from camber.schemas.fleet import ReleaseHead
from camber.schemas.gnss import Fix
from camber.schemas.health import Health, HealthRequest
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Motion
from camber.schemas.road import LinksReply
from support.messages import build, message_classes, messages

every_message = pytest.mark.parametrize("cls", message_classes(), ids=lambda cls: cls.__name__)
settings.register_profile("same every time", derandomize=True, deadline=None, max_examples=50)
settings.load_profile("same every time")


def raw(header: bytes, tail: bytes = b"") -> bytes:
    return struct.pack("<I", len(header)) + header + tail


def of(cls: type[Message], fields: Any, tail: bytes = b"", source: Any = "", sequence: Any = 0) -> bytes:
    return raw(msgpack.packb([cls.schema_name(), source, sequence, fields]), tail)


def filled(cls: type[Message]) -> Any:
    return build(cls, Random(cls.__name__), filled=True)


def refused_or_valid(cls: type[Message], data: bytes) -> None:
    """Anything but DecodeError fails the test; what is accepted must be a message that can be sent on."""
    try:
        received = decode(cls, data)
    except DecodeError:
        return
    assert decode(cls, encode(received.message)).message == received.message


@every_message
@given(data=st.data())
def test_what_goes_out_comes_back(cls: type[Message], data: st.DataObject) -> None:
    message = data.draw(messages(cls))
    source, sequence = data.draw(st.text("abc_.é", max_size=64)), data.draw(st.integers(0, 2**62 - 1))
    received = decode(cls, encode(message, source=source, sequence=sequence), encoding_of(cls))
    assert received.message == message
    assert (received.source, received.sequence) == (source, sequence)


@every_message
@settings(max_examples=20)
@given(data=st.data())
def test_equal_messages_are_equal_bytes(cls: type[Message], data: st.DataObject) -> None:
    message = data.draw(messages(cls))
    assert encode(decode(cls, encode(message)).message) == encode(message)


@every_message
@given(garbage=st.binary(max_size=300))
def test_random_bytes_are_refused(cls: type[Message], garbage: bytes) -> None:
    refused_or_valid(cls, garbage)
    refused_or_valid(cls, raw(garbage))
    refused_or_valid(cls, raw(b"\x94" + msgpack.packb(cls.schema_name()) + garbage))


@every_message
def test_every_truncation_is_refused(cls: type[Message]) -> None:
    data = encode(filled(cls), source="gnss", sequence=3)
    for length in range(len(data)):
        with pytest.raises(DecodeError):
            decode(cls, data[:length])


@every_message
def test_bytes_after_the_end_are_refused(cls: type[Message]) -> None:
    with pytest.raises(DecodeError, match="behind the last array"):
        decode(cls, encode(filled(cls)) + b"\0")


@every_message
def test_a_flipped_bit_gives_a_valid_message_or_is_refused(cls: type[Message]) -> None:
    data = encode(filled(cls), source="gnss", sequence=3)
    for bit in range(0, 8 * len(data), 1 + 8 * len(data) // 1000):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        refused_or_valid(cls, bytes(flipped))


@every_message
@given(data=st.data())
def test_spliced_bytes_give_a_valid_message_or_are_refused(cls: type[Message], data: st.DataObject) -> None:
    whole = encode(filled(cls))
    start = data.draw(st.integers(0, len(whole)))
    end = data.draw(st.integers(start, min(len(whole), start + 40)))
    refused_or_valid(cls, whole[:start] + data.draw(st.binary(max_size=20)) + whole[end:])


@every_message
@given(value=st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=8)
    | st.binary(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
    max_leaves=8,
), data=st.data())  # fmt: skip
def test_a_field_of_another_kind_gives_a_valid_message_or_is_refused(
    cls: type[Message], value: Any, data: st.DataObject
) -> None:
    refused_or_valid(
        cls, changed(encode(filled(cls)), data.draw(st.sampled_from(sorted(cls.model_fields))), value)
    )


def changed(data: bytes, field: str, value: Any) -> bytes:
    """The bytes of a message with another value for one field, and its arrays as they were."""
    end = 4 + struct.unpack_from("<I", data)[0]
    header = msgpack.unpackb(data[4:end], ext_hook=msgpack.ExtType)
    header[3][field] = value
    packed = msgpack.packb(header)
    tail = data[end + -end % 8 :]
    return raw(packed, b"\0" * (-(4 + len(packed)) % 8 if tail else 0) + tail)


@every_message
def test_bytes_of_one_message_are_not_taken_for_another(cls: type[Message]) -> None:
    other = Motion if cls is not Motion else Fix
    with pytest.raises(DecodeError, match=f"expected camber.{other.__name__}.v1"):
        decode(other, encode(filled(cls)))


@pytest.mark.parametrize(
    "encoding",
    [
        *("application/msgpack;camber.Fix.v2", "application/msgpack;camber.Pose.v1", "application/json"),
        *("", "é" * 999),
    ],
)
def test_another_encoding_is_refused(encoding: str) -> None:
    with pytest.raises(DecodeError, match=r"expected encoding application/msgpack;camber\.Fix\.v1"):
        decode(Fix, encode(filled(Fix)), encoding)


def test_another_version_in_the_bytes_is_refused() -> None:
    data = encode(filled(Fix)).replace(b"camber.Fix.v1", b"camber.Fix.v2")
    with pytest.raises(DecodeError, match=r"expected camber\.Fix\.v1, got 'camber\.Fix\.v2'"):
        decode(Fix, data)


def test_an_integer_is_taken_for_a_float() -> None:
    message = decode(Fix, of(Fix, filled(Fix).model_dump() | {"height_m": 43})).message
    assert message.height_m == 43.0
    assert type(message.height_m) is float


NAN, INF = float("nan"), float("inf")
BAD_VALUES: dict[str, list[Any]] = {
    "height_m": [NAN, INF, True, "43", None],
    "fix_id": [1.0, True, -1, 2**64 - 1],
    "time_ns": [2**63, 0],
    "quality": ["Fixed"],
    "datum": ["WGS84\n"],
    "latitude_rad": [1.6],
    "covariance_enu_m2": [(1.0,) * 5, (NAN,) * 6, (-1.0, 0.0, 0.0, 1.0, 0.0, 1.0), {}],
    "unheard_of": [1],
}


@pytest.mark.parametrize(
    ("field", "value"), [(field, value) for field, values in BAD_VALUES.items() for value in values]
)
def test_a_bad_value_is_refused_and_its_field_named(field: str, value: Any) -> None:
    with pytest.raises(DecodeError, match=rf"^Fix\.{field}"):
        decode(Fix, of(Fix, filled(Fix).model_dump() | {field: value}))


def test_a_missing_field_is_named() -> None:
    fields = filled(Fix).model_dump()
    del fields["height_m"]
    with pytest.raises(DecodeError, match=r"^Fix\.height_m: Field required"):
        decode(Fix, of(Fix, fields))


def test_a_field_that_stands_there_twice_is_refused() -> None:
    time = filled(HealthRequest).time_ns
    twice = b"\x82" + 2 * (msgpack.packb("time_ns") + msgpack.packb(time))
    header = b"\x94" + b"".join(map(msgpack.packb, (HealthRequest.schema_name(), "", 0))) + twice
    with pytest.raises(DecodeError, match="stands there twice"):
        decode(HealthRequest, raw(header))


def test_text_that_is_not_utf8_is_refused() -> None:
    data = encode(filled(HealthRequest), source="gnss")
    for text in (b"gnss", b"time_ns", b"HealthRequest"):
        with pytest.raises(DecodeError, match="UnicodeDecodeError"):
            decode(HealthRequest, data.replace(text, b"\xff" + text[1:]))


def test_bytes_are_not_taken_for_text() -> None:
    for field in ("quality", "datum"):
        with pytest.raises(DecodeError):
            decode(Fix, changed(encode(filled(Fix)), field, b"fixed"))


def test_a_change_of_nothing_is_accepted() -> None:
    """So that the refusals above are of the value, and not of how the test writes bytes."""
    for cls in message_classes():
        message = filled(cls)
        assert decode(cls, changed(encode(message), "time_ns", message.time_ns)).message == message


@pytest.mark.parametrize(
    ("source", "sequence"),
    [(None, 0), ("", None), ("", -1), ("", True), ("", 2**62), ("", 1.0), ("a" * 65, 0), (b"", 0)],
)
def test_an_envelope_out_of_range_is_refused(source: Any, sequence: Any) -> None:
    with pytest.raises(DecodeError):
        decode(HealthRequest, of(HealthRequest, filled(HealthRequest).model_dump(), b"", source, sequence))


@pytest.mark.parametrize(("source", "sequence"), [("a" * 65, 0), ("", -1), ("", 2**62)])
def test_an_envelope_out_of_range_is_not_sent(source: str, sequence: int) -> None:
    with pytest.raises(ValueError, match="out of range"):
        encode(filled(HealthRequest), source=source, sequence=sequence)


def array(code: str, *shape: int) -> msgpack.ExtType:
    return msgpack.ExtType(1, code.encode() + struct.pack(f"<{len(shape)}I", *shape))


def sweep(points: Any, intensity: Any, offset: Any, tail: bytes) -> bytes:
    fields = {"sensor": "a", "points_m": points, "intensity": intensity, "offset_ns": offset}
    packed = msgpack.packb([Sweep.schema_name(), "", 0, {"time_ns": filled(Sweep).time_ns, **fields}])
    return raw(packed, b"\0" * (-(4 + len(packed)) % 8) + tail)


def test_arrays_come_as_they_were_sent_and_nobody_can_change_them() -> None:
    tail = np.arange(3, dtype="<f4").tobytes() + b"\0" * 4 + np.float32(7).tobytes() + b"\0" * 4 + b"\xff" * 4
    message = decode(Sweep, sweep(array("<f4", 1, 3), array("<f4", 1), array("<i4", 1), tail)).message
    assert message.points_m.tolist() == [[0.0, 1.0, 2.0]]
    assert message.offset_ns.tolist() == [-1]
    with pytest.raises(ValueError, match="read-only"):
        message.points_m[0, 0] = 5.0
    with pytest.raises(ValueError, match="WRITEABLE"):
        message.points_m.flags.writeable = True


@pytest.mark.parametrize(
    "points",
    [
        *(array(kind, 1, 3) for kind in ("<f8", ">f4", "|O8", "<M8")),
        *(array("<f4", *shape) for shape in [(3,), (1, 1, 3), (1, 1, 1, 3), (), (1, 4), (2**31, 2**31)]),
        *(array("<f4", *shape) for shape in [(2**32 - 1,) * 3, (0, 2**32 - 1)]),
        msgpack.ExtType(1, b""),
        msgpack.ExtType(1, b"<f4\0\0"),
        msgpack.ExtType(2, b"<f4" + struct.pack("<II", 1, 3)),
        msgpack.ExtType(1, b"<f4" + bytes(400)),
        b"\0" * 12,
        [0.0, 1.0, 2.0],
        None,
    ],
)
def test_an_array_of_another_kind_is_refused(points: Any) -> None:
    with pytest.raises(DecodeError):
        decode(Sweep, sweep(points, array("<f4", 1), array("<i4", 1), bytes(28)))


@pytest.mark.parametrize(
    ("rows", "tail", "why"),
    [
        *(
            (1, np.array([0, bad, 0], "<f4").tobytes() + bytes(16), r"^Sweep\.points_m: .*finite")
            for bad in (NAN, INF, -INF)
        ),
        (2, bytes(28), "intensity has 2 rows where points_m has 1 points"),
        (1, bytes(12) + b"\1" + bytes(15), "hidden"),
        (1, bytes(32), "4 bytes behind the last array"),
    ],
)
def test_arrays_that_are_not_those_of_the_fields_are_refused(rows: int, tail: bytes, why: str) -> None:
    with pytest.raises(DecodeError, match=why):
        decode(Sweep, sweep(array("<f4", 1, 3), array("<f4", rows), array("<i4", 1), tail))


def test_offsets_that_lead_outside_are_refused() -> None:
    links = filled(LinksReply)
    data, good = encode(links), links.first_vertex.tobytes()
    for bad in ([1, 1], [0, -1], [0, len(links.latitude_rad) + 1]):
        first = np.array([*bad[:1], *[bad[1]] * (len(links.first_vertex) - 1)], "<i4")
        with pytest.raises(DecodeError, match=r"first_vertex|offsets"):
            decode(LinksReply, data.replace(good, first.tobytes()))


@given(codes=st.lists(st.integers(-128, 127), max_size=3), data=st.binary(max_size=20))
def test_extensions_of_other_kinds_are_refused(codes: list[int], data: bytes) -> None:
    for code in codes:
        ext = b"\xc7" + bytes([len(data)]) + struct.pack("b", code) + data  # as no packer would write it
        fields = b"\x81" + msgpack.packb("time_ns") + ext
        with pytest.raises(DecodeError):
            decode(Motion, raw(b"\x94" + msgpack.packb(Motion.schema_name()) + b"\xa0\x00" + fields))


def test_a_message_too_long_for_its_header_is_not_sent() -> None:
    health = build(Health, Random(1), filled=True)
    issue = health.issues[0].model_copy(update={"text": "高" * 512})
    with pytest.raises(ValueError, match="records belong into arrays"):
        encode(health.model_copy(update={"issues": (issue,) * 64}))


def test_a_message_of_more_bytes_than_any_peer_takes_is_not_sent() -> None:
    n = 5_000_000
    points, one = np.zeros((n, 3), "<f4"), np.zeros(n, "<f4")
    time_ns, offset = filled(Sweep).time_ns, np.zeros(n, "<i4")
    big = Sweep(time_ns=time_ns, sensor="a", points_m=points, intensity=one, offset_ns=offset)
    with pytest.raises(ValueError, match="at most 67108864 are allowed"):
        encode(big)


def test_what_is_no_bytes_at_all_is_refused() -> None:
    for nothing in (None, "text", 7, []):
        with pytest.raises(DecodeError):
            decode(ReleaseHead, nothing)  # type: ignore[arg-type]
