"""`camber export --rosbag`: what the judge published, as messages that ROS programs read."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from camber.formats.ros.message_types import VERDICT_TYPE, message_types, stamp_unix_ns
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.geodesy.local_frame import LocalFrame
from camber.schemas.integrity import CONFIRMED_VERDICTS
from camber.tools.bags import export_command
from support.refusals import Refused
from support.running import recorded, replayed

_OPTIONS = ("--set", "end_s=60.0", "--set", "horizontal_reference=assumed", "--set", "alert_limit_m=20.0")


@pytest.fixture(scope="module")
def run(blind: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of the short drive: wrong fixes at its start, float stretches, a gap."""
    return replayed(blind, tmp_path_factory.mktemp("export") / "run", *_OPTIONS)


@pytest.fixture(scope="module")
def bag(run: Path) -> Path:
    out = run.parent / "bag"
    assert export_command.main([str(run), "--rosbag", str(out)]) == 0
    return out


def read(bag: Path) -> dict[str, list[Any]]:
    """Messages by topic, by the definitions in the bag itself."""
    by_topic: dict[str, list[Any]] = {}
    with AnyReader([bag]) as reader:
        for connection, at_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            assert at_ns == stamp_unix_ns(message)
            by_topic.setdefault(connection.topic, []).append(message)
    return by_topic


def test_every_verdict_and_position_is_in_the_bag(run: Path, bag: Path) -> None:
    messages, topics = recorded(run), read(bag)
    verdicts = [item.message for item in messages["verdict"]]
    assert [stamp_unix_ns(message) for message in topics["/camber/verdict"]] == [
        unix_ns_from_gps_ns(verdict.time_ns) for verdict in verdicts
    ]
    assert [message.reason for message in topics["/camber/verdict"]] == [v.reason for v in verdicts]
    assert len(topics["/camber/fix"]) == sum(verdict.fix_id is not None for verdict in verdicts)
    positions = [item.message for item in messages["position"]]
    assert len(topics["/diagnostics"]) == len(positions)
    assert len(topics["/camber/pose"]) == sum(position.usable for position in positions)


def test_a_status_is_above_no_fix_only_for_confirmed_and_usable_fixes(run: Path, bag: Path) -> None:
    messages = recorded(run)
    verdicts = [item.message for item in messages["verdict"] if item.message.fix_id is not None]
    usable = {
        item.message.fix_id
        for item in messages["position"]
        if item.message.usable and item.message.source == "rtk"
    }
    fixes = read(bag)["/camber/fix"]
    assert all(
        (message.status.status == 2) == (verdict.verdict in CONFIRMED_VERDICTS and verdict.fix_id in usable)
        for verdict, message in zip(verdicts, fixes, strict=True)
    )
    statuses = Counter(
        (verdict.verdict, message.status.status)
        for verdict, message in zip(verdicts, read(bag)["/camber/fix"], strict=True)
    )
    assert set(statuses) <= {
        ("confirmed", 2),
        ("confirmed_after_verification", 2),
        ("confirmed", -1),
        ("confirmed_after_verification", -1),
        ("erroneous", -1),
        ("unknown", -1),
    }
    assert statuses["confirmed", 2] > 100
    assert statuses["erroneous", -1] > 10


def test_poses_are_in_a_frame_whose_origin_the_bag_contains(run: Path, bag: Path) -> None:
    with AnyReader([bag]) as reader:
        custom = reader.readers[0].storage.metadata.custom
    latitude_deg, longitude_deg, height_m = map(float, custom["map_origin"].split())
    frame = LocalFrame(math.radians(latitude_deg), math.radians(longitude_deg), height_m)
    usable = [item.message for item in recorded(run)["position"] if item.message.usable]
    assert len(usable) > 100
    for position, message in zip(usable, read(bag)["/camber/pose"], strict=True):
        expected = frame.enu_from_geodetic(position.latitude_rad, position.longitude_rad, position.height_m)
        place = message.pose.pose.position
        assert (place.x, place.y, place.z) == pytest.approx(expected, abs=1e-3)
        assert message.pose.covariance.reshape(6, 6)[0, 0] == position.covariance_enu_m2[0]


def test_the_bag_has_definitions_and_hashes_of_its_types(bag: Path) -> None:
    with AnyReader([bag]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        assert kinds == export_command.TOPICS
    metadata = (bag / "metadata.yaml").read_text()
    for kind in export_command.TOPICS.values():
        assert message_types().hash_rihs01(kind) in metadata
    assert VERDICT_TYPE in metadata


def test_another_reader_of_mcap_finds_the_same_messages(bag: Path) -> None:
    with (bag / "bag.mcap").open("rb") as stream:
        kinds = Counter(schema.name for schema, _, _ in make_reader(stream).iter_messages() if schema)
    expected = {kind: len(read(bag)[topic]) for topic, kind in export_command.TOPICS.items()}
    assert kinds == expected


def test_a_damaged_recording_gives_what_is_before_the_damage(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = (run / "recording.mcap").read_bytes()
    (tmp_path / "half.mcap").write_bytes(data[: len(data) // 2])
    assert export_command.main([str(tmp_path / "half.mcap"), "--rosbag", str(tmp_path / "bag")]) == 0
    assert "half.mcap at byte" in capsys.readouterr().out
    assert 0 < len(read(tmp_path / "bag")["/camber/verdict"]) < len(recorded(run)["verdict"])


def test_what_cannot_be_exported_is_one_line(run: Path, bag: Path, tmp_path: Path, refused: Refused) -> None:
    line = refused(export_command.main, run, "--rosbag", bag)
    assert line == f"camber export: {bag}: not empty, expected a new folder"
    (tmp_path / "b").mkdir()
    assert "none.mcap" in refused(export_command.main, tmp_path / "none.mcap", "--rosbag", tmp_path / "b")
    (tmp_path / "no.mcap").write_bytes(np.zeros(100, np.uint8).tobytes())
    assert "no.mcap" in refused(export_command.main, tmp_path / "no.mcap", "--rosbag", tmp_path / "b")
    assert not any((tmp_path / "b").iterdir())
    assert export_command.main([str(run), "--rosbag", str(tmp_path / "b")]) == 0
