"""What a hostile peer claims costs neither memory nor time: the bytes decide, not what they say of themselves."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import tracemalloc
from random import Random

import msgpack
import pytest

from camber.schemas.base import Message
from camber.schemas.codec import DecodeError, decode, encode
from camber.schemas.gnss import Estimates
from camber.schemas.health import Health
from camber.schemas.lidar import Sweep
from support.messages import build

HEADER_BYTES = 1 << 16


def _claims() -> dict[str, bytes]:
    """Headers of up to 64 KiB, by what they try."""
    room = HEADER_BYTES - 200
    array_4g, map_4g = b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff"
    array_16, array_256 = b"\x9f", b"\xdc\x01\x00"
    key = msgpack.packb("time_ns")
    candidates = msgpack.packb("candidates")
    excluded = msgpack.packb("excluded_satellites")
    names = b"\x81" + excluded + b"\xdc\x00\x64" + b"\xa0" * 100
    pairs = b"".join(msgpack.packb(f"{i:x}") + b"\xc0" for i in range(256))
    return {
        "an array of 2^32": array_4g,
        "a map of 2^32": map_4g,
        "a text of 2^32": b"\xdb\xff\xff\xff\xff",
        "bytes of 2^32": b"\xc6\xff\xff\xff\xff",
        "an extension of 2^32": b"\xc9\xff\xff\xff\xff\x01",
        "an array of 2^31 × 2^31": b"\x81" + key + b"\xc7\x0b\x01<f4" + struct.pack("<II", 2**31, 2**31),
        "arrays within arrays": array_16 * room,
        "single arrays within arrays": b"\x91" * room,
        "long arrays within arrays": array_256 * (room // 3),
        "arrays of 2^32 within arrays": array_4g * (room // 5),
        "maps within maps": (b"\x81" + key) * (room // 9),
        "empty maps": array_256 + (array_256 + b"\x80" * 256) * (room // 259),
        "single maps": array_256 + (array_256 + (b"\x81" + key + b"\xc0") * 200) * (room // 2100),
        "many empty candidates": b"\x81" + candidates + b"\xdc\x00\x64" + b"\x80" * 100,
        "many bad names": b"\x81" + candidates + b"\xdc\x00\x64" + names * 100,
        "many unknown fields": b"\x81" + candidates + b"\xdc\x00\x28" + (b"\xde\x01\x00" + pairs) * 40,
        "a long unknown field": b"\x81" + b"\xda\xf0\x00" + b"x" * 0xF000 + b"\xc0",
    }  # fmt: skip


def _bytes_of(cls: type[Message], fields: bytes) -> bytes:
    header = b"\x94" + msgpack.packb(cls.schema_name()) + b"\xa0\x00" + fields
    assert len(header) <= HEADER_BYTES
    return struct.pack("<I", len(header)) + header


@pytest.mark.parametrize("claim", _claims())
@pytest.mark.parametrize("cls", [Estimates, Health, Sweep])
def test_memory_follows_the_bytes_and_not_the_claim(cls: type[Message], claim: str) -> None:
    data = _bytes_of(cls, _claims()[claim])
    tracemalloc.start()
    try:
        with pytest.raises(DecodeError) as caught:
            decode(cls, data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 12e6
    assert len(str(caught.value)) <= 400


def test_a_message_of_many_arrays_is_not_copied() -> None:
    sweep = build(Sweep, Random(5), filled=True)
    n = 200_000
    big = Sweep(
        time_ns=sweep.time_ns,
        sensor="top",
        points_m=sweep.points_m[:1].repeat(n, axis=0),
        intensity=sweep.intensity[:1].repeat(n),
        offset_ns=sweep.offset_ns[:1].repeat(n),
    )
    data = encode(big)
    tracemalloc.start()
    try:
        decode(Sweep, data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < len(data) / 4


@pytest.mark.parametrize("claimed", [2**32 - 1, 2**31, HEADER_BYTES + 1])
def test_a_header_longer_than_allowed_is_refused_whether_or_not_it_is_there(claimed: int) -> None:
    for data in (bytes(1), bytes(100), bytes(HEADER_BYTES + 1)):
        with pytest.raises(DecodeError, match="claimed"):
            decode(Health, struct.pack("<I", claimed) + data)


_LIMITED = """
import pathlib, resource, sys
from camber.schemas import codec, gnss, health, lidar
used = int(pathlib.Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (64 << 20),) * 2)
resource.setrlimit(resource.RLIMIT_CPU, (30, 30))
classes = {cls.__name__: cls for cls in (gnss.Estimates, health.Health, lidar.Sweep)}
for line in sys.stdin:
    name, data = line.split()
    try:
        codec.decode(classes[name], bytes.fromhex(data))
    except codec.DecodeError as error:
        assert "MemoryError" not in str(error), error
        print("refused")
"""


def test_a_process_with_little_memory_and_time_survives_every_claim() -> None:
    attacks = [(cls, claim) for cls in (Estimates, Health, Sweep) for claim in _claims().values()]
    lines = "".join(f"{cls.__name__} {_bytes_of(cls, claim).hex()}\n" for cls, claim in attacks)
    done = subprocess.run(
        [sys.executable, "-c", _LIMITED],
        input=lines,
        capture_output=True,
        text=True,
        timeout=120,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"},
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.split() == ["refused"] * len(attacks)
