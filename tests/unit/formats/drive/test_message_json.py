"""Messages as JSON: read back they are the same bytes, and their schemas say what is written."""

from __future__ import annotations

import json
from random import Random
from typing import Any

import pytest

from camber.formats.drive.message_json import from_json, json_schema, to_json
from camber.schemas.base import Message, arrays_of
from camber.schemas.codec import DecodeError, encode, unpack
from camber.schemas.gnss import Fix, ReceiverBytes
from camber.schemas.integrity import Verdict
from camber.schemas.motion import Motion
from support.messages import build, message_classes

CLASSES = message_classes()


def written(message: Message) -> bytes:
    return to_json(unpack(encode(message)).fields, type(message))


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_written_and_read_every_message_is_the_same_bytes(cls: type[Message]) -> None:
    for seed in range(40):
        message = build(cls, Random(f"{cls.__name__} {seed}"), filled=seed == 0)
        assert encode(from_json(cls, written(message))) == encode(message), f"seed {seed}"


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_what_is_written_is_what_the_schema_says(cls: type[Message]) -> None:
    for seed in range(20):
        message = build(cls, Random(f"{cls.__name__} {seed}"), filled=seed == 0)
        assert_described(json.loads(written(message)), json_schema(cls))


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_schemas_have_only_what_viewers_read(cls: type[Message]) -> None:
    """Foxglove Studio and Lichtblick refuse a channel with references, alternatives or lists within lists."""

    def check(schema: dict[str, Any]) -> None:
        assert schema["type"] in {"boolean", "string", "number", "integer", "object", "array"}
        assert not {"$ref", "anyOf", "oneOf", "prefixItems"} & set(schema)
        if schema["type"] == "object":
            for part in schema["properties"].values():
                check(part)
        elif schema["type"] == "array":
            assert schema["items"]["type"] != "array"
            check(schema["items"])

    check(json_schema(cls))
    assert json_schema(cls)["properties"]["time_ns"]["type"] == "integer"


def test_an_array_has_at_most_one_length_that_is_not_fixed() -> None:
    shapes = [kind.shape for cls in CLASSES for _, kind in arrays_of(cls)]
    assert all(sum(isinstance(length, str) for length in shape) <= 1 for shape in shapes)


def test_doubles_are_exact() -> None:
    random = Random(20260101)
    for _ in range(2000):
        speed = random.choice(
            [random.uniform(-1000.0, 1000.0), random.random() * 10.0 ** random.randint(-300, 2)]
        )
        message = Motion(time_ns=1_400_000_000_000_000_000, wheel_speed_m_s=speed)
        assert from_json(Motion, written(message)).wheel_speed_m_s == speed
    negative_zero = Motion(time_ns=1_400_000_000_000_000_000, wheel_speed_m_s=-0.0)
    assert encode(from_json(Motion, written(negative_zero))) == encode(negative_zero)


def test_what_is_not_known_is_absent() -> None:
    verdict = Verdict(time_ns=1_400_000_000_000_000_000, fix_id=None, verdict="unknown", reason="gnss_absent")
    fields = json.loads(written(verdict))
    assert "fix_id" not in fields
    assert "null" not in written(verdict).decode()
    assert from_json(Verdict, written(verdict)) == verdict


def test_bytes_are_base64() -> None:
    message = build(ReceiverBytes, Random(1), filled=True)
    payload = json.loads(written(message))["payload"]
    assert isinstance(payload, str)
    assert json_schema(ReceiverBytes)["properties"]["payload"]["contentEncoding"] == "base64"


@pytest.mark.parametrize("value", [float("nan"), float("inf"), b"bytes"])
def test_what_json_does_not_have_is_refused(value: object) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 (json's own text)
        to_json({"time_ns": 1, "x": value}, None)


FIX = json.loads(written(build(Fix, Random(2), filled=True)))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b"null",
        b"{",
        b"[" * 100_000,
        b'{"time_ns": NaN}',
        b"\xff",
        json.dumps({**FIX, "more": 1}).encode(),
        json.dumps({**FIX, "time_ns": 1.5}).encode(),
        json.dumps({**FIX, "covariance_enu_m2": {"a": 1}}).encode(),
        json.dumps({**FIX, "latitude_rad": "1.0"}).encode(),
    ],
)
def test_damaged_json_is_one_error(data: bytes) -> None:
    with pytest.raises(DecodeError):
        from_json(Fix, data)


@pytest.mark.parametrize("payload", ["no base64!", 5, [1, 2], {"a": 1}])
def test_damaged_bytes_are_one_error(payload: object) -> None:
    fields = {"time_ns": 1_400_000_000_000_000_000, "protocol": "ubx", "payload": payload}
    with pytest.raises(DecodeError):
        from_json(ReceiverBytes, json.dumps(fields).encode())


@pytest.mark.parametrize("values", [[1.5], ["1"], [2**40], [[1], [2]], [[1], 2], [None], "1", {"a": 1}, 7])
def test_numbers_that_an_array_does_not_hold_are_one_error(values: object) -> None:
    from camber.schemas.pose import ScanMatch

    fields = {"time_ns": 1_400_000_000_000_000_000, "status": "converged", "layer": values}
    with pytest.raises(DecodeError):
        from_json(ScanMatch, json.dumps(fields).encode())


def assert_described(value: Any, schema: dict[str, Any]) -> None:
    """Assert that a value has the types, limits and fields of a schema."""
    kinds = {"boolean": bool, "string": str, "integer": int, "number": float, "object": dict, "array": list}
    assert isinstance(value, kinds[schema["type"]])
    if "enum" in schema:
        assert value in schema["enum"]
    if schema["type"] in ("number", "integer"):
        assert schema.get("minimum", value) <= value <= schema.get("maximum", value)
    if schema["type"] == "array":
        for item in [item for item in value if item is not None]:
            assert_described(item, schema["items"])
    if schema["type"] == "object":
        assert set(schema.get("required", ())) <= set(value)
        for name, part in value.items():
            more = schema.get("additionalProperties")
            assert_described(part, schema["properties"].get(name) or more)
