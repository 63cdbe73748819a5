"""The log in the recording of a replay: issues at their time, within the drive, and not again and again."""

from __future__ import annotations

from pathlib import Path

from mcap.reader import make_reader

from camber.formats.foxglove.protobuf import decode
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.replay.run_folder import RunFolder
from camber.replay.run_recorder import RunRecorder
from camber.replay.short_drive import START_NS, write_short_drive
from camber.schemas.drive import load_manifest

SECOND_NS = 1_000_000_000


def test_an_issue_has_a_time_of_the_drive_and_is_not_repeated_at_once(tmp_path: Path) -> None:
    manifest = load_manifest(write_short_drive(tmp_path / "drive", 1))
    folder = RunFolder(tmp_path)
    with RunRecorder(folder, manifest, START_NS) as recorder:
        recorder.add_issue(0, "map_server", "surrogate_map: streets")  # before the first tick
        for n in range(1, 25):
            recorder.add_issue(START_NS + n * SECOND_NS, "gnss", "receiver_silent: nothing")
    with folder.recording_path.open("rb") as stream:
        read = [
            (message.log_time, decode("Log", message.data))
            for _, _, message in make_reader(stream).iter_messages()
        ]
    begin_ns = unix_ns_from_gps_ns(START_NS)
    assert [log_ns - begin_ns for log_ns, _ in read] == [0, SECOND_NS, 11 * SECOND_NS, 21 * SECOND_NS]
    assert {(line["name"], line["level"]) for _, line in read} == {("map_server", 3), ("gnss", 3)}
    assert all(line["timestamp"]["seconds"] * SECOND_NS == log_ns for log_ns, line in read)
