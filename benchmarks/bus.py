"""Replays and live runs of all services beside bare Zenoh, and the codec beside plain msgpack. Loopback only."""

from __future__ import annotations

import json
import os
import tempfile
import threading
from pathlib import Path
from typing import Any

import bare_zenoh
import msgpack
import numpy as np
from figure import Figure, camber, higher, lower, per_call_us

from camber.formats.drive.recording import load_recording
from camber.replay.short_drive import RATE_HZ, write_short_drive
from camber.schemas.base import Message
from camber.schemas.codec import decode, encode
from camber.schemas.pose import Pose
from camber.schemas.road import ElevationReply, ElevationRequest

NAGOYA = Path(__file__).parents[1] / "tests" / "replay" / "nagoya.toml"
LATENCY_S = 60.0
GOAL_P99_MS = 8.0
GOAL_TIMES_BARE = 5.0


def replay(drive: Path, out: Path, *options: str) -> dict[str, Any]:
    camber("replay", drive, "--processes", "--out", out, "--quiet", *options, timeout_s=150.0)
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return summary


def sizes_of(out: Path) -> dict[str, int]:
    """Bytes of each kind of message, the median of a replay's."""
    messages, _ = load_recording(out / "recording.mcap")
    channels = {"receiver": "receiver_bytes", "fix": "fix", "pose": "pose", "verdict": "verdict"}
    sizes = {
        name: int(np.median([len(encode(item.message, source="localizer")) for item in messages[channel]]))
        for name, channel in channels.items()
    }
    pose: Pose = messages["pose"][-1].message
    assert pose.latitude_rad is not None
    assert pose.longitude_rad is not None
    request = ElevationRequest(
        time_ns=pose.time_ns,
        latitude_rad=pose.latitude_rad,
        longitude_rad=pose.longitude_rad,
        link_ids=(1, 2, 3),
    )
    reply = ElevationReply(time_ns=pose.time_ns, road=pose.road)
    return sizes | {"question": len(encode(request, source="localizer")), "answer": len(encode(reply))}


def lock_step(drive: Path, out: Path) -> tuple[list[Figure], dict[str, int]]:
    summary = replay(drive, out)
    sizes = sizes_of(out)
    bare = bare_zenoh.lock_step_per_s(sizes["fix"], seconds=5.0)
    ours = summary["epochs"] / summary["wall_s"]
    peer = (
        f"bare Zenoh, one epoch at a time through {bare_zenoh.STAGES} Python processes that only pass it on"
    )
    return [higher("replay of the short drive, real services", "epochs/s", ours, bare, peer)], sizes


def latency(drive: Path, out: Path, sizes: dict[str, int], what: str) -> list[Figure]:
    """Both at the same time, so that both meet the same load."""
    bare_ms: list[float] = []
    stop = threading.Event()
    bare = threading.Thread(
        target=lambda: bare_ms.extend(bare_zenoh.latencies_ms(sizes, rate_hz=RATE_HZ, stop=stop)), daemon=True
    )
    bare.start()
    try:
        summary = replay(drive, out, "--speed", "1", "--set", f"end_s={LATENCY_S}")
    finally:
        stop.set()
        bare.join()
    peer = "bare Zenoh: messages of the same size over the same hops at the same time"
    return [
        lower(
            f"fix received to verdict received, p{q}, {what}",
            "ms",
            summary["latency_ms"][f"p{q}"],
            float(np.percentile(bare_ms, q)),
            peer,
        )
        for q in (50, 99)
    ]


def codec(out: Path) -> list[Figure]:
    messages, _ = load_recording(out / "recording.mcap")
    figures = []
    for channel in ("fix", "pose", "verdict"):
        message: Message = messages[channel][-1].message
        data, fields = encode(message, source="gnss", sequence=7), message.model_dump()
        plain = msgpack.packb(fields)
        pairs = (
            (
                "encode",
                lambda m=message: encode(m, source="gnss", sequence=7),
                lambda f=fields: msgpack.packb(f),
            ),
            ("decode", lambda m=message, d=data: decode(type(m), d), lambda p=plain: msgpack.unpackb(p)),
        )
        for name, ours, peer in pairs:
            peer_name = "plain msgpack of the same fields, nothing checked"
            figures.append(
                lower(f"{name} a {channel}", "µs", per_call_us(ours), per_call_us(peer), peer_name)
            )
    return figures


def goal(p99: Figure) -> str:
    met = p99.ours <= GOAL_P99_MS and p99.ours <= GOAL_TIMES_BARE * p99.peer
    return (
        f"goal: p99 of the verdict at most {GOAL_P99_MS:g} ms and at most {GOAL_TIMES_BARE:g} times bare Zenoh's "
        f"({GOAL_TIMES_BARE * p99.peer:.1f} ms): {'met' if met else 'NOT met'} with {p99.ours:.1f} ms"
    )


def figures() -> list[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        short = write_short_drive(folder / "drive")
        nagoya = bool(os.environ.get("CAMBER_DATA"))
        at_most, sizes = lock_step(short, folder / "max")
        drive, what = (
            (NAGOYA, "Nagoya, 60 s") if nagoya else (short, "short drive, 60 s: CAMBER_DATA is not set")
        )
        live = latency(drive, folder / "live", sizes, what)
        print(goal(live[-1]))
        return live + at_most + codec(folder / "max")
