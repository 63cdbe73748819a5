"""Files of a recording that goes on."""

from __future__ import annotations

import shutil
from collections import namedtuple
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from camber.formats.drive.recording import Recorded, read_recording
from camber.formats.foxglove.drawings import Drawing
from camber.runtime.raw_subscription import RawSample
from camber.schemas.codec import encode
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Motion
from camber.tools.record.record import chosen, main
from camber.tools.record.recording_files import RecordingFiles, RecordingLimits
from support.messages import build
from support.refusals import Refused

T = 1_300_000_000 * 10**9
UNIX = 1_700_000_000 * 10**9
OPEN = RecordingLimits(free_bytes=0)


def motions(first: int, count: int) -> list[RawSample]:
    motion = build(Motion, Random(1), filled=True)
    return [
        RawSample(
            "motion",
            "camber/v1/car/vehicle/motion",
            encode(motion.model_copy(update={"time_ns": T + n * 10**8}), source="vehicle", sequence=n),
            UNIX + n * 10**8,
        )
        for n in range(first, first + count)
    ]


def recorded(
    folder: Path, batches: int, count: int, *, every_s: float = 1.0, **limits: Any
) -> RecordingFiles:
    """The files of so many batches of `count` messages each."""
    files = RecordingFiles(folder, "car", RecordingLimits(free_bytes=0, **limits))
    for n in range(batches):
        files.write(motions(count * n, count), now_s=100.0 + every_s * n)
    files.close()
    return files


def sequences(path: Path) -> list[int]:
    items = list(read_recording(path))
    assert all(isinstance(item, Recorded) for item in items), items
    return [item.sequence for item in items]  # type: ignore[union-attr]


def test_a_file_ends_when_it_is_long_enough_and_nothing_is_lost_between(tmp_path: Path) -> None:
    files = recorded(tmp_path, 5, 10, every_s=4.0, file_s=10.0)
    assert [sequences(path) for path in files.files] == [list(range(30)), list(range(30, 50))]
    assert files.written == 50
    assert files.files[0].name == "car-20231114T221320Z-000.mcap"


def test_a_file_ends_when_it_is_large_enough(tmp_path: Path) -> None:
    files = recorded(tmp_path, 40, 1000, file_bytes=100_000)
    assert len(files.files) > 2
    assert [n for path in files.files for n in sequences(path)] == list(range(40_000))
    assert all(path.stat().st_size < 1_500_000 for path in files.files)


def test_the_oldest_go_also_those_of_earlier_runs_and_never_of_others(tmp_path: Path) -> None:
    (tmp_path / "car-20200101T000000Z-000.mcap").write_bytes(b"x" * 500_000)
    (tmp_path / "bus-20200101T000000Z-000.mcap").write_bytes(b"x" * 500_000)
    files = recorded(tmp_path, 30, 100, every_s=2.0, file_s=1.0, kept_bytes=20_000)
    left = sorted(path.name for path in tmp_path.iterdir())
    assert "bus-20200101T000000Z-000.mcap" in left
    assert "car-20200101T000000Z-000.mcap" not in left
    assert files.files[-1].name in left
    assert files.files[0].name not in left


def test_files_of_a_vehicle_whose_name_begins_alike_are_not_deleted(tmp_path: Path) -> None:
    others = {"car-2-20200101T000000Z-000.mcap", "car-notes.mcap"}
    for name in others:
        (tmp_path / name).write_bytes(b"x" * 500_000)
    files = recorded(tmp_path, 1, 10, kept_bytes=20_000)
    assert {path.name for path in tmp_path.iterdir()} == {files.files[0].name, *others}


def test_an_old_file_that_cannot_be_deleted_hinders_nothing(tmp_path: Path) -> None:
    stuck = tmp_path / "car-20200101T000000Z-000.mcap"
    stuck.mkdir()  # unlink says no, also to root
    files = recorded(tmp_path, 3, 10, every_s=2.0, file_s=1.0, kept_bytes=1)
    assert (files.written, files.problem) == (30, None)
    assert sorted(tmp_path.iterdir()) == [stuck, files.files[-1]]


def test_recorders_of_one_second_and_one_folder_keep_what_the_others_wrote(tmp_path: Path) -> None:
    first, second = (RecordingFiles(tmp_path, "car", OPEN) for _ in range(2))
    for n in range(3):
        first.write(motions(10 * n, 10), now_s=float(n))
        second.write(motions(5 + 10 * n, 10), now_s=float(n))
    first.close()
    second.close()
    later = recorded(tmp_path, 1, 5)
    names = [path.name[-8:] for files in (first, second, later) for path in files.files]
    assert names == ["000.mcap", "001.mcap", "002.mcap"]
    assert sequences(first.files[0]) == list(range(30))
    assert sequences(second.files[0]) == list(range(5, 35))
    assert sequences(later.files[0]) == list(range(5))


def test_all_that_the_tap_has_kept_is_written_though_it_is_much_at_once(tmp_path: Path) -> None:
    n = 100_000
    points_m, offset_ns = np.zeros((n, 3), np.float32), np.zeros(n, np.int32)
    sweep = Sweep(time_ns=T, sensor="top", points_m=points_m, intensity=points_m[:, 0], offset_ns=offset_ns)
    one = RawSample("sweep", "camber/v1/car/vehicle/sweep", encode(sweep, source="vehicle", sequence=0), UNIX)
    files = RecordingFiles(tmp_path, "car", OPEN)
    files.write([one] * 50, now_s=0.0)
    files.close()
    assert 50 * len(one.data) > 64 << 20
    assert (files.written, files.dropped) == (50, 0)


def test_a_kill_costs_seconds_whatever_times_stand_in_the_messages(tmp_path: Path) -> None:
    files = RecordingFiles(tmp_path, "car", OPEN)
    files.write(motions(10**9, 1), now_s=0.0)  # three years ahead: a clock that is set back, or a mistake
    for n in range(1, 61):
        files.write(motions(10 * n, 10), now_s=float(n))
    (path,) = files.files  # as a kill leaves it
    assert sum(isinstance(item, Recorded) for item in read_recording(path)) > 490
    files.close()


def test_where_the_disk_is_nearly_full_the_file_is_ended_properly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "total used free")
    free = [10 << 20]
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(0, 0, free[0]))
    files = RecordingFiles(tmp_path, "car", RecordingLimits(free_bytes=5 << 20))
    files.write(motions(0, 10), now_s=0.0)
    free[0] = 1 << 20
    files.write(motions(10, 10), now_s=1.0)
    files.write(motions(20, 10), now_s=2.0)
    files.close()
    assert files.problem is not None
    assert "1 MB free on the disk" in files.problem
    assert sequences(files.files[0]) == list(range(20))
    assert (files.written, files.dropped) == (20, 10)


def test_what_was_dropped_before_stands_in_the_file(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    files = RecordingFiles(tmp_path, "car", OPEN)
    files.write(motions(0, 10), now_s=0.0)
    files.write(motions(10, 10), now_s=1.0, lost=7)
    files.close()
    assert files.dropped == 7
    with files.files[0].open("rb") as stream:
        _, metadata = [item.metadata for item in make_reader(stream).iter_metadata()]
    assert metadata["dropped"] == "7"


def test_each_file_begins_with_the_roads_of_the_map(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    limits, roads = RecordingLimits(file_s=10.0), Drawing("/map/roads", "GeoJSON", b"")
    files = RecordingFiles(tmp_path, "car", limits, roads=roads)
    for n in range(3):
        files.write(motions(10 * n, 10), now_s=11.0 * n)
    files.close()
    assert len(files.files) == 3
    for path in files.files:
        with path.open("rb") as stream:
            read = [
                (channel.topic, message.log_time)
                for _, channel, message in make_reader(stream).iter_messages()
            ]
        assert [topic for topic, _ in read].count("/map/roads") == 1
        (time_ns,) = [log_ns for topic, log_ns in read if topic == "/map/roads"]
        assert abs(time_ns - UNIX) < 60 * 10**9


def test_a_map_that_is_none_is_wrong_usage(tmp_path: Path, refused: Refused) -> None:
    assert refused(main, "--out", tmp_path, "--map", tmp_path / "nosuch").startswith("camber record: ")


def test_a_folder_that_cannot_be_written_is_an_error_at_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError):  # noqa: PT011 (which one depends on the system)
        RecordingFiles(tmp_path / "file", "car", OPEN)


def test_all_channels_but_sweeps_unless_they_are_wanted() -> None:
    names = {channel.name for channel in chosen(None, None, sweeps=False)}
    assert {"fix", "pose", "verdict", "motion", "release"} <= names
    assert not names & {"sweep", "health", "elevation", "tick", "upload"}
    assert "sweep" in {channel.name for channel in chosen(None, None, sweeps=True)}
    assert [channel.name for channel in chosen("sweep,fix", "fix", sweeps=False)] == ["sweep"]


@pytest.mark.parametrize(
    ("names", "without"), [("nosuch", None), ("health", None), (None, "nosuch"), ("fix", "fix")]
)
def test_a_channel_that_cannot_be_recorded_is_named(names: str | None, without: str | None) -> None:
    with pytest.raises(ValueError, match=r"channel"):
        chosen(names, without, sweeps=False)


def test_what_is_kept_has_room_for_a_file_before_the_one_that_is_written(
    tmp_path: Path, refused: Refused
) -> None:
    (tmp_path / "vehicle-20200101T000000Z-000.mcap").write_bytes(b"x")
    line = refused(main, "--out", tmp_path, "--keep-mb", "1500")
    assert line == "camber record: --keep-mb 1500: expected at least 2048, twice --max-mb"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_file_in_place_of_the_folder_is_wrong_usage(tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "file"
    path.write_text("")
    assert refused(main, "--out", path) == f"camber record: --out {path}: File exists"
