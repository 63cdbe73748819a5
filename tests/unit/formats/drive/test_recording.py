"""Recordings: exact, read by any program, in an order that is not that of arrival, readable after every accident."""

from __future__ import annotations

import json
import random
import resource
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from camber.formats.drive.mcap_recorder import Recorder
from camber.formats.drive.recording import (
    Recorded,
    RecordingError,
    load_recording,
    read_about,
    read_recording,
    topic_of,
)
from camber.formats.errors import FormatError
from camber.schemas.channels import BY_NAME, CHANNELS
from camber.schemas.codec import encode
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Motion
from camber.schemas.road import LinksRequest

START_NS = 1_373_000_000_000_000_000
START_UTC = datetime(2023, 7, 10, 4, 53, 2, tzinfo=UTC)
MOTION_KEY = "camber/v1/car/vehicle/motion"
SWEEP_KEY = "camber/v1/car/vehicle/sweep"
LINKS_KEY = "camber/v1/car/map_server/links"


def motion(i: int) -> Motion:
    return Motion(time_ns=START_NS + i * 100_000_000, wheel_speed_m_s=float(i % 500))


def sweep(i: int) -> Sweep:
    points = np.full((5, 3), float(i), np.float32)
    zeros = {"intensity": np.zeros(5, np.float32), "offset_ns": np.zeros(5, np.int32)}
    return Sweep(time_ns=START_NS + i * 100_000_000, sensor="top", points_m=points, **zeros)


def record(path: Path, count: int = 300) -> list[Motion]:
    """A recording of several chunks: one motion a tick, one sweep in ten."""
    messages = [motion(i) for i in range(count)]
    with Recorder(path) as recorder:
        for i, message in enumerate(messages):
            payload = encode(message, source="vehicle", sequence=i)
            recorder.add("motion", payload, key=MOTION_KEY, arrival_ns=1_000 + i)
            if i % 10 == 0:
                payload = encode(sweep(i), source="vehicle", sequence=i // 10)
                recorder.add("sweep", payload, key=SWEEP_KEY, arrival_ns=1_000 + i)
            recorder.tick_done()
    assert recorder.problem is None
    return messages


def read(path: Path, channel: str) -> tuple[list[object], list[RecordingError]]:
    lists, errors = load_recording(path, [channel])
    return [item.message for item in lists[channel]], errors


def test_recorded_messages_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    messages = record(path)
    lists, errors = load_recording(path)
    assert errors == []
    assert [item.message for item in lists["motion"]] == messages
    assert [item.message for item in lists["sweep"]] == [sweep(i) for i in range(0, 300, 10)]
    assert lists["fix"] == []
    assert lists["motion"][7] == Recorded(
        channel="motion", key=MOTION_KEY, message=messages[7], source="vehicle", sequence=7, arrival_ns=1_007
    )


def test_only_the_channels_asked_for_are_given(tmp_path: Path) -> None:
    record(tmp_path / "recording.mcap")
    items = list(read_recording(tmp_path / "recording.mcap", ["sweep"]))
    assert {item.channel for item in items if isinstance(item, Recorded)} == {"sweep"}
    assert len(items) == 30


def test_a_program_that_knows_only_mcap_and_json_reads_messages_at_their_utc(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    payload = encode(motion(3), source="vehicle", sequence=5)
    with Recorder(path, about={"drive": "street"}) as recorder:
        recorder.add("motion", payload, key=MOTION_KEY, arrival_ns=1_700_000_000_000_000_123)
    with path.open("rb") as stream:
        reader = make_reader(stream)
        ((schema, channel, message),) = reader.iter_messages()
        about, end = reader.iter_metadata()
    assert json.loads(message.data) == {"time_ns": motion(3).time_ns, "wheel_speed_m_s": 3.0}
    assert datetime.fromtimestamp(message.log_time / 1e9, UTC) == START_UTC + timedelta(seconds=0.3)
    assert (message.publish_time, message.sequence) == (1_700_000_000_000_000_123, 5)
    assert schema is not None
    assert (schema.name, schema.encoding) == ("camber.Motion.v1", "jsonschema")
    assert json.loads(schema.data)["properties"]["wheel_speed_m_s"]["type"] == "number"
    assert (channel.topic, channel.message_encoding) == ("/vehicle/motion", "json")
    assert channel.metadata == {"channel": "motion", "key": MOTION_KEY, "source": "vehicle"}
    assert (about.name, about.metadata["drive"]) == ("camber.drive", "street")
    assert (end.name, end.metadata["complete"]) == ("camber.recording", "yes")
    assert read_about(path)["drive"] == "street"


def test_a_sequence_number_beyond_32_bits_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    numbers = [7, 2**32 - 1, 2**32, 2**62 - 1]
    with Recorder(path) as recorder:
        for i, number in enumerate(numbers):
            data = encode(motion(i), source="vehicle", sequence=number)
            recorder.add("motion", data, key=MOTION_KEY, arrival_ns=0)
    lists, errors = load_recording(path, ["motion"])
    assert ([item.sequence for item in lists["motion"]], errors) == (numbers, [])


def test_recordings_of_before_are_read(tmp_path: Path) -> None:
    """Then a message was the bytes of the bus, its topic the key, and log_time GPS time."""
    path = tmp_path / "before.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4)
        writer.start("camber", library="camber")
        for key, name, messages in (
            (MOTION_KEY, "motion", [motion(i) for i in range(50)]),
            (SWEEP_KEY, "sweep", [sweep(i) for i in range(5)]),
        ):
            schema = writer.register_schema(messages[0].schema_name(), "jsonschema", b"{}")
            number = writer.register_channel(key, "msgpack", schema, {"channel": name})
            for i, message in enumerate(messages):
                data = encode(message, source="vehicle", sequence=i)
                writer.add_message(number, message.time_ns, data, publish_time=1_000 + i, sequence=i)
        writer.finish()
    lists, errors = load_recording(path)
    assert errors == []
    assert [item.message for item in lists["motion"]] == [motion(i) for i in range(50)]
    assert [item.message for item in lists["sweep"]] == [sweep(i) for i in range(5)]
    assert lists["motion"][7] == Recorded(
        channel="motion", key=MOTION_KEY, message=motion(7), source="vehicle", sequence=7, arrival_ns=1_007
    )


def test_topics_have_no_vehicle(tmp_path: Path) -> None:
    for channel, key, topic in [
        ("fix", "camber/v1/car/gnss/fix", "/gnss/fix"),
        ("fix", "camber/v1/gnss/gnss/fix", "/gnss/fix"),
        ("upload_batch", "camber/v1/fleet/car/upload_batch", "/fleet/upload_batch"),
        ("release", "camber/v1/fleet/release", "/fleet/release"),
        ("fix", "elsewhere", "/elsewhere"),
    ]:
        assert topic_of(BY_NAME[channel], key) == topic


def test_request_and_reply_of_one_key_are_distinguished(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    request = LinksRequest(time_ns=START_NS, latitude_rad=0.6, longitude_rad=2.3, radius_m=100.0)
    with Recorder(path) as recorder:
        recorder.add("links", encode(request), key=LINKS_KEY, arrival_ns=0)
    assert read(path, "links") == ([request], [])


def test_order_within_a_tick_does_not_depend_on_arrival(tmp_path: Path) -> None:
    """Seeded shuffles of the same messages give the same file, once arrival is the same."""
    rng = random.Random(20260101)
    sent = [
        (channel, encode(message, source=source, sequence=sequence), key)
        for sequence in range(4)
        for channel, message, key, source in (
            ("motion", motion(sequence), MOTION_KEY, "vehicle"),
            ("sweep", sweep(sequence), SWEEP_KEY, "vehicle"),
            ("motion", motion(sequence), "camber/v1/bus/vehicle/motion", "vehicle"),
            # Two senders that number alike under one key.
            ("motion", motion(sequence + 50), MOTION_KEY, "other"),
        )
    ]
    files = []
    for trial in range(5):
        rng.shuffle(sent)
        path = tmp_path / f"{trial}.mcap"
        with Recorder(path) as recorder:
            for channel, payload, key in sent:
                recorder.add(channel, payload, key=key, arrival_ns=0)
            recorder.tick_done()
        files.append(path.read_bytes())
    assert len(set(files)) == 1
    recorded = [i for i in read_recording(path) if isinstance(i, Recorded)]
    read_back = [(i.message.time_ns, i.channel, i.key, i.sequence) for i in recorded]
    order = {channel.name: place for place, channel in enumerate(CHANNELS)}
    assert read_back == sorted(read_back, key=lambda item: (item[0], order[item[1]], item[2], item[3]))
    assert len(read_back) == len(sent)


def test_arrival_is_the_only_difference_between_two_runs(tmp_path: Path) -> None:
    for name, delay in (("a", 0), ("b", 777)):
        with Recorder(tmp_path / name) as recorder:
            for i in range(50):
                recorder.add("motion", encode(motion(i), sequence=i), key=MOTION_KEY, arrival_ns=i + delay)
                recorder.tick_done()
    first, second = (load_recording(tmp_path / name, ["motion"])[0]["motion"] for name in "ab")
    assert [(i.message, i.sequence) for i in first] == [(i.message, i.sequence) for i in second]
    assert [i.arrival_ns + 777 for i in first] == [i.arrival_ns for i in second]


def test_a_file_cut_anywhere_yields_the_messages_before_the_cut_and_one_error(tmp_path: Path) -> None:
    whole = tmp_path / "recording.mcap"
    messages = record(whole)
    data = whole.read_bytes()
    rng = random.Random(7)
    lengths = {0, 1, 7, 8, 9, len(data) - 1, len(data) - 8, len(data) - 9}
    lengths |= {rng.randrange(len(data)) for _ in range(60)}
    read_counts = []
    for length in sorted(lengths):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(data[:length])
        read_back, errors = read(cut, "motion")
        assert len(errors) == 1, f"cut at {length}"
        assert "\n" not in str(errors[0])
        assert str(errors[0]).startswith("cut.mcap")
        assert read_back == messages[: len(read_back)], f"cut at {length}"
        read_counts.append(len(read_back))
    assert read_counts == sorted(read_counts)
    assert 0 < read_counts[len(read_counts) // 2] < len(messages)


def test_damaged_bytes_never_raise_and_never_change_a_message(tmp_path: Path) -> None:
    whole = tmp_path / "recording.mcap"
    record(whole, count=3000)
    known = [item for item in read_recording(whole) if isinstance(item, Recorded)]
    data = whole.read_bytes()
    rng = random.Random(8)
    noticed = 0
    for _ in range(60):
        damaged = bytearray(data)
        damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        (tmp_path / "damaged.mcap").write_bytes(damaged)
        items = list(read_recording(tmp_path / "damaged.mcap"))
        read_back = [item for item in items if isinstance(item, Recorded)]
        assert [f.message for f in read_back] == [k.message for k in known[: len(read_back)]]
        noticed += any(isinstance(item, RecordingError) for item in items)
    # Half of the file is an index, which is not read.
    assert noticed > 20


@pytest.mark.parametrize("data", [b"", b"no recording at all, just text", b"\x89MCAP0\r\n" + bytes(64)])
def test_another_file_is_one_clear_error(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "x.mcap").write_bytes(data)
    read_back, errors = read(tmp_path / "x.mcap", "motion")
    assert read_back == []
    assert len(errors) == 1
    assert isinstance(errors[0], FormatError)
    assert "expected a whole MCAP recording" in str(errors[0])


def test_messages_of_another_version_are_one_error_and_the_rest_is_read(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    newer = encode(motion(0), sequence=0).replace(b"camber.Motion.v1", b"camber.Motion.v9")
    with Recorder(path) as recorder:
        for i in range(3):
            recorder.add("motion", newer, key=MOTION_KEY, arrival_ns=i)
        recorder.add("motion", encode(motion(1), sequence=1), key=MOTION_KEY, arrival_ns=9)
    read_back, errors = read(path, "motion")
    assert read_back == [motion(1)]
    assert len(errors) == 1
    assert "camber.Motion.v9" in str(errors[0])
    assert "3 are not" in str(errors[0])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize("tick", [12, 20_000], ids=["between ticks", "within a tick"])
def test_a_full_disk_ends_the_recording_and_not_the_program(tick: int) -> None:
    recorder = Recorder(Path("/dev/full"))
    for i in range(20_000):
        recorder.add("motion", encode(motion(i), sequence=i), key=MOTION_KEY, arrival_ns=i)
        if i % tick == tick - 1:
            recorder.tick_done()
    recorder.add("motion", encode(motion(0)), key=MOTION_KEY, arrival_ns=0)
    recorder.close()
    assert recorder.problem is not None
    assert "No space left" in recorder.problem
    assert recorder.dropped > 0
    assert recorder.written + recorder.dropped == 20_001


@pytest.mark.parametrize("limit_bytes", [100, 40_000, 1_000_000])
def test_messages_counted_as_written_can_be_read_after_a_full_disk(tmp_path: Path, limit_bytes: int) -> None:
    rng = np.random.default_rng(limit_bytes)
    path = tmp_path / "recording.mcap"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, hard))
    try:
        recorder = Recorder(path)
        for i in range(100):  # noise, which does not compress
            noisy = sweep(i).model_copy(update={"points_m": rng.normal(size=(2000, 3)).astype(np.float32)})
            noisy = noisy.model_copy(
                update={"intensity": np.zeros(2000, np.float32), "offset_ns": np.zeros(2000, np.int32)}
            )
            recorder.add("sweep", encode(noisy, sequence=i), key=SWEEP_KEY, arrival_ns=i)
            recorder.tick_done()
        recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert recorder.problem is not None
    read_back, _ = read(path, "sweep")
    assert (recorder.written, recorder.dropped) == (len(read_back), 100 - len(read_back))
    assert (len(read_back) > 0) == (limit_bytes > 300_000)


def test_more_than_the_limit_within_one_tick_is_dropped_and_counted(tmp_path: Path) -> None:
    payloads = [encode(motion(i), sequence=i) for i in range(10)]
    limit = sum(len(payload) for payload in payloads[:4])
    with Recorder(tmp_path / "recording.mcap", limit_bytes=limit) as recorder:
        for payload in payloads:
            recorder.add("motion", payload, key=MOTION_KEY, arrival_ns=0)
        recorder.tick_done()
        recorder.add("motion", payloads[9], key=MOTION_KEY, arrival_ns=0)
    read_back, _ = read(tmp_path / "recording.mcap", "motion")
    assert read_back == [*(motion(i) for i in range(4)), motion(9)]
    assert (recorder.written, recorder.dropped) == (5, 6)


def test_ever_new_names_of_schemas_do_not_end_the_recording(tmp_path: Path) -> None:
    payload = encode(motion(0), source="vehicle", sequence=0)
    path = tmp_path / "recording.mcap"
    with Recorder(path) as recorder:
        for i in range(70_000):  # MCAP has numbers for 65,535
            invented = payload.replace(b"camber.Motion.v1", b"camber.M%08d" % i)
            recorder.add("motion", invented, key=MOTION_KEY, arrival_ns=0)
        recorder.add("motion", payload, key=MOTION_KEY, arrival_ns=0)
    assert recorder.problem is None
    assert recorder.written + recorder.malformed == 70_001
    assert recorder.malformed > 69_000
    read_back, errors = read(path, "motion")
    assert read_back == [motion(0)]
    assert {error.field for error in errors} == {"schema"}


def test_a_file_that_is_there_is_kept_where_a_new_one_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    messages = record(path)
    with pytest.raises(FileExistsError):
        Recorder(path, anew=True)
    assert read(path, "motion") == (messages, [])


@pytest.mark.parametrize("payload", [b"", b"abc", b"\xff" * 40, b"\x04\0\0\0\x93abc", encode(motion(1))[:20]])
def test_a_malformed_message_is_counted_and_not_written(tmp_path: Path, payload: bytes) -> None:
    with Recorder(tmp_path / "recording.mcap") as recorder:
        recorder.add("motion", payload, key=MOTION_KEY, arrival_ns=0)
    assert (recorder.malformed, recorder.written) == (1, 0)
    assert read(tmp_path / "recording.mcap", "motion") == ([], [])


def test_a_recording_that_was_never_closed_can_be_read_up_to_its_last_chunk(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    recorder = Recorder(path)
    for i in range(250):
        recorder.add("motion", encode(motion(i), sequence=i), key=MOTION_KEY, arrival_ns=0)
        recorder.tick_done()
    # As after a kill: nothing is closed. Chunks go out every 10 s of measured time.
    read_back, errors = read(path, "motion")
    recorder.close()
    assert read_back == [motion(i) for i in range(len(read_back))]
    assert len(read_back) >= 200
    assert len(errors) == 1
