"""A peer that says nothing but what is malformed, to every input of every service, while a vehicle drives.

Access rules keep unknown peers off the bus (docs/security.md); here one is on it. Twenty thousand messages; a million
is `make hostile`.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import pytest

from camber.schemas.channels import BY_NAME, SERVICES
from camber.schemas.codec import DecodeError, decode
from camber.schemas.integrity import Verdict
from hostile.malformed import channels, malformed
from soak.readings import read
from support.fault_figures import measured
from support.live_drive import BEGIN_S, write_drive
from support.live_vehicle import LiveVehicle, driving, now_ns
from support.running import (
    endpoint_of,
    free_endpoint,
    payloads,
    process_ids,
    replaying,
    started,
    summary_of,
    wait_until,
)

pytestmark = pytest.mark.slow

COUNT = 10_000  # in each of the two tests
SEED = 11
RATE_HZ = 1_000.0
REPLAY_S = 16.0
END_S = BEGIN_S + REPLAY_S
MOST_MB = 40.0  # of one service: its queues, full of large messages, and what an allocator keeps of them


@contextmanager
def peer(endpoint: str, count: int, rate_hz: float, *more: str):
    with started("-m", "hostile.peer", endpoint, "demo", count, SEED, rate_hz, *more) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == "ready"
        yield process


def sent_by(process) -> Counter[str]:
    """Number of messages the peer has sent, by kind, once it has ended."""
    output, _ = process.communicate(timeout=300.0)
    assert process.returncode == 0, output
    return Counter(json.loads(output.splitlines()[-1])["kinds"])


def test_every_input_and_query_is_attacked_by_every_kind():
    made = list(malformed("demo", 1_400_000_000_000_000_000, SEED, of_each=1))
    keys = {item.key for item in made}
    expected = {c.key_for("demo") for c in channels() if "{service}" not in c.key}
    assert expected <= keys
    assert {f"camber/v1/demo/{name}/health" for name in SERVICES} <= keys
    assert len({(item.key, item.kind) for item in made}) == len(keys) * len({item.kind for item in made})


def verdicts(out: Path) -> list[bytes]:
    """The bytes of the verdicts of the judge; the peer never uses that source name."""
    verdicts = []
    for data in payloads(out)[BY_NAME["verdict"].key_for("demo")]:
        try:
            source = decode(Verdict, data).source
        except DecodeError:
            continue
        if source == "integrity":
            verdicts.append(data)
    return verdicts


def test_a_peer_with_malformed_messages_does_not_change_a_replay(tmp_path):
    manifest = write_drive(tmp_path / "drive")
    with replaying(manifest, tmp_path / "alone", END_S, "max") as alone:
        output, _ = alone.communicate(timeout=300.0)
        assert alone.returncode == 0, output
    out = tmp_path / "attacked"
    with replaying(manifest, out, END_S, 1) as attacked:
        wait_until(lambda: process_ids(out), timeout_s=180.0, why="no services were started")
        with peer(endpoint_of(out), COUNT, 2 * RATE_HZ, "replayed") as hostile:
            services = process_ids(out)
            output, _ = attacked.communicate(timeout=300.0)
            hostile.terminate()
    # The peer's messages are in the recording too; the evaluation refuses what is none of this version.
    assert attacked.returncode == 0 or "expected messages of this version" in output, output
    assert process_ids(out) == services, "a service has died and was started again"
    usual = verdicts(tmp_path / "alone")
    assert verdicts(out) == usual
    assert len(usual) >= REPLAY_S * 5
    assert summary_of(tmp_path / "alone")["confirmed"]["wrong"] == 0
    messages = payloads(out)[BY_NAME["verdict"].key_for("demo")]
    assert len(messages) > len(usual) + 20, "no message of the peer arrived"


def test_a_live_vehicle_confirms_right_fixes_and_no_wrong_one_meanwhile(tmp_path):
    vehicle = LiveVehicle(tmp_path, free_endpoint(), services=SERVICES)
    with driving(vehicle, live=True) as witness:
        before = {name: read(process.pid, 0.0) for name, process in vehicle.running.items()}
        began_s = time.monotonic()
        with peer(vehicle.endpoint, COUNT, RATE_HZ) as hostile:
            witness.wait_for_trust(time.monotonic(), timeout_s=180.0)
            assert hostile.poll() is None, "the peer was over before anything was confirmed"
            kinds = sent_by(hostile)
        after_s = witness.wait_for_new_trust(timeout_s=180.0)
        verdict_counts = witness.verdict_counts(began_s)
        assert vehicle.ended() == {}
        assert all(vehicle.health(name, timeout_s=20.0).status == "ok" for name in SERVICES)
        after = {name: read(process.pid, 0.0) for name, process in vehicle.running.items()}
    assert len(kinds) == len({item.kind for item in malformed("demo", now_ns(), SEED, of_each=1)})
    assert not witness.wrong_but_trusted(began_s), verdict_counts
    assert verdict_counts["right", "confirmed"] > 0
    grown = {name: after[name].uss_mb - before[name].uss_mb for name in after}
    assert max(grown.values()) < MOST_MB, grown
    measured(
        "hostile peer", sent=sum(kinds.values()), confirmed_after_s=after_s, memory_mb=max(grown.values())
    )
