"""The recording of a replay: read by programs that know nothing of Camber, and played onto a bus again."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from camber.formats.drive.recording import load_recording, read_about
from camber.schemas.codec import encode
from support.running import MACHINE, camber, camber_started, loopback_router, python, summary_of, wait_until

OTHER_PROGRAM = """
import json, sys
from datetime import UTC, datetime
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

counts, protobuf, dates = {}, set(), set()
with open(sys.argv[1], "rb") as stream:
    reader = make_reader(stream, decoder_factories=[DecoderFactory()])
    for schema, channel, message in reader.iter_messages():
        if channel.message_encoding == "json":
            fields = json.loads(message.data)
            assert schema.encoding == "jsonschema" and json.loads(schema.data)["type"] == "object"
            assert set(fields) <= set(json.loads(schema.data)["properties"]), channel.topic
            # GPS time is 18 s ahead of UTC and begins in 1980.
            assert fields["time_ns"] + 315_964_782_000_000_000 == message.log_time, channel.topic
        else:
            protobuf.add(channel.topic)
        dates.add(datetime.fromtimestamp(message.log_time / 1e9, UTC).date().isoformat())
        counts[channel.topic] = counts.get(channel.topic, 0) + 1
with open(sys.argv[1], "rb") as stream:
    reader = make_reader(stream, decoder_factories=[DecoderFactory()])
    for schema, channel, message, drawn in reader.iter_decoded_messages(topics=protobuf):
        at = drawn.entities[0].timestamp if "SceneUpdate" in schema.name else getattr(drawn, "timestamp", None)
        if schema.name == "foxglove.GeoJSON":
            assert json.loads(drawn.geojson)["type"] == "FeatureCollection"
        else:
            assert at.seconds * 10**9 + at.nanos == message.log_time, channel.topic
assert not [name for name in sys.modules if name.startswith("camber")]
print(json.dumps([counts, sorted(dates)]))
"""


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demo")
    done = camber("demo", "--short", "--out", out, timeout_s=300.0)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture
def endpoint() -> Iterator[str]:
    with loopback_router() as endpoint:
        yield endpoint


def test_a_program_without_camber_reads_every_message_at_its_date(replayed: Path) -> None:
    done = python("-c", OTHER_PROGRAM, replayed / "recording.mcap", timeout_s=120.0)
    assert done.returncode == 0, done.stderr
    counts, dates = json.loads(done.stdout)
    assert dates == ["2024-05-17"]
    about = read_about(replayed / "recording.mcap")
    assert (about["drive"], about["vehicle"]) == ("short-drive", "demo")
    assert json.loads(about["settings"])["integrity"]["alert_limit_m"] == 1.5
    lists, errors = load_recording(replayed / "recording.mcap")
    assert errors == []
    ours = {"/gnss/fix": "fix", "/integrity/verdict": "verdict", "/integrity/position": "position"}
    assert all(counts[topic] == len(lists[name]) > 100 for topic, name in ours.items())
    assert counts["/gnss/fix/location"] == len(lists["fix"])
    assert counts["/integrity/verdict/location"] == sum(
        item.message.fix_id is not None for item in lists["verdict"]
    )
    assert {
        "/integrity/position/track",
        "/integrity/position/levels",
        "/log",
        "/transforms",
        "/map/roads",
    } <= set(counts)


def test_played_and_recorded_again_verdicts_are_the_same_bytes_and_figures_the_same(
    replayed: Path, endpoint: str, tmp_path: Path
) -> None:
    source, out = replayed / "recording.mcap", tmp_path / "again"
    with ExitStack() as stack:
        options = ("--vehicle", "demo", "--connect", endpoint, "--leave-mb", "1")
        process = stack.enter_context(camber_started("record", "--out", tmp_path / "rec", *options))
        wait_until(lambda: (tmp_path / "rec").exists(), timeout_s=30.0, why="it records")
        done = camber(
            "play", source, "--connect", endpoint, "--times", "recorded", "--speed", "10", timeout_s=200.0
        )
        assert done.returncode == 0, done.stderr
        process.terminate()
        output, _ = process.communicate(timeout=30.0)
    assert "0 dropped, 0 malformed" in output
    (path,) = (tmp_path / "rec").glob("*.mcap")
    before, after = load_recording(source)[0], load_recording(path)[0]

    def sent(channel: str, lists: dict[str, list]) -> list[bytes]:
        items = lists[channel]
        return [encode(i.message, source=i.source, sequence=i.sequence) for i in items]

    for channel in before:
        assert sent(channel, after) == sent(channel, before), channel
    assert len(before["verdict"]) > 100
    shutil.copytree(
        replayed, out, ignore=shutil.ignore_patterns("work", "state", "recording.mcap", "summary.json")
    )
    shutil.copy(path, out / "recording.mcap")
    assert camber("evaluate", out, timeout_s=120.0).returncode == 0

    def figures(folder: Path) -> dict[str, object]:
        return {name: value for name, value in summary_of(folder).items() if name not in MACHINE}

    assert figures(out) == figures(replayed)
