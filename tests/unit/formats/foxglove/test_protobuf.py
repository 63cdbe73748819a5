"""Foxglove's messages as they are encoded here: read by the library of protobuf, and described as the SDK does."""

from __future__ import annotations

from random import Random
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.json_format import MessageToDict

from camber.formats.foxglove.point_clouds import cloud_from_sweep, sweep_from_cloud
from camber.formats.foxglove.protobuf import ProtobufError, decode, descriptor_set, encode
from camber.schemas.codec import DecodeError
from camber.schemas.codec import encode as bytes_of
from camber.schemas.lidar import Sweep
from support.messages import build

NAMES = ("FrameTransform", "GeoJSON", "LocationFix", "Log", "PointCloud", "PoseInFrame", "SceneUpdate")
COLOUR = {"r": 0.25, "g": 0.5, "b": 0.125, "a": 1.0}
VALUES: dict[str, dict[str, Any]] = {
    "FrameTransform": {"parent_frame_id": "local", "rotation": {"w": 1.0}},
    "GeoJSON": {"geojson": '{"type":"Point","coordinates":[1,2]}'},
    "LocationFix": {
        "timestamp": {"seconds": 1_700_000_000, "nanos": 5},
        "latitude": 35.0,
        "longitude": -136.5,
        "position_covariance": [1.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 9.0],
        "position_covariance_type": 3,
        "color": COLOUR,
        "metadata": [{"key": "a", "value": "é"}, {"key": "b", "value": ""}],
    },
    "Log": {"timestamp": {"seconds": -1}, "level": 3, "message": "x" * 300, "line": 7},
    "PointCloud": {"point_stride": 4, "fields": [{"name": "x", "type": 7}], "data": b"\x00\x01\x02\x03"},
    "PoseInFrame": {"frame_id": "local", "pose": {"position": {"x": 1e-300}, "orientation": {"w": 1.0}}},
    "SceneUpdate": {"entities": [{"id": "a", "frame_locked": True, "cylinders": [{"color": COLOUR}]}]},
}


def message_of(name: str, data: bytes) -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(descriptor_set(name)).file:
        pool.Add(file)
    cls = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))
    message = cls()
    assert message.ParseFromString(data) == len(data)
    return message


@pytest.mark.parametrize("name", NAMES)
def test_protobuf_reads_what_is_written_and_writes_the_same(name: str) -> None:
    message = message_of(name, encode(name, VALUES[name]))
    options = {"preserving_proto_field_name": True, "use_integers_for_enums": True}
    read = MessageToDict(message, **options)
    for field, value in VALUES[name].items():
        if field not in ("timestamp", "data"):  # of which the library makes text
            assert read[field] == _without_empty(value)
    assert message.SerializeToString() == message_of(name, message.SerializeToString()).SerializeToString()
    assert decode(name, message.SerializeToString()) == decode(name, encode(name, VALUES[name]))


def _without_empty(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_empty(part) for name, part in value.items() if part != ""}
    return [_without_empty(part) for part in value] if isinstance(value, list) else value


@pytest.mark.parametrize("name", NAMES)
def test_schemas_are_those_of_foxglove_s_sdk(name: str) -> None:
    messages = pytest.importorskip("foxglove.messages", reason="camber[foxglove] is not installed")
    schema = getattr(messages, "GeoJson" if name == "GeoJSON" else name).get_schema()
    assert (schema.name, schema.encoding) == (f"foxglove.{name}", "protobuf")
    assert schema.data == descriptor_set(name)


def test_a_field_that_a_message_lacks_is_an_error() -> None:
    with pytest.raises(KeyError):
        encode("Log", {"nosuch": 1})


def test_damaged_bytes_are_one_error_or_another_message() -> None:
    random, refused = Random(20260102), 0
    data = encode("SceneUpdate", VALUES["SceneUpdate"])
    for _ in range(500):
        damaged = bytearray(data[: random.randrange(len(data) + 1)])
        for _ in range(random.randrange(3) if damaged else 0):
            damaged[random.randrange(len(damaged))] ^= 1 << random.randrange(8)
        try:
            decode("SceneUpdate", bytes(damaged))
        except ProtobufError:
            refused += 1
    assert refused > 100


@pytest.mark.parametrize("points", [0, 1, 5000])
def test_a_sweep_as_a_point_cloud_is_read_back_byte_for_byte(points: int) -> None:
    random = np.random.default_rng(points)
    sweep = Sweep(
        time_ns=1_400_000_000_123_456_789,
        sensor="top",
        points_m=random.normal(size=(points, 3)).astype("<f4"),
        intensity=random.random(points).astype("<f4"),
        offset_ns=-random.integers(0, 10**8, points).astype("<i4"),
    )
    data = cloud_from_sweep(sweep)
    assert bytes_of(sweep_from_cloud(data)) == bytes_of(sweep)
    cloud = message_of("PointCloud", data)
    assert cloud.frame_id == "top"
    assert [(field.name, field.offset) for field in cloud.fields][:3] == [("x", 0), ("y", 4), ("z", 8)]
    xyz = np.frombuffer(cloud.data, "<f4").reshape(points, 5)[:, :3]
    assert np.array_equal(xyz, sweep.points_m)


def test_another_or_a_damaged_cloud_is_one_error() -> None:
    random = Random(20260103)
    data = cloud_from_sweep(build(Sweep, random, filled=True))
    others = [encode("PointCloud", VALUES["PointCloud"]), data[:-1], b"", b"\xff" * 30]
    for _ in range(300):
        damaged = bytearray(data)
        damaged[random.randrange(len(damaged))] ^= 1 << random.randrange(8)
        others.append(bytes(damaged))
    errors = 0
    for other in others:
        try:
            sweep_from_cloud(other)
        except DecodeError:
            errors += 1
    assert errors > 4
