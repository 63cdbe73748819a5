"""The gnss service remembers its bases over restarts: nothing damaged is trusted, and nothing that moved is used."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from camber.gnss.observations.base_coordinate_history import BaseMemory, memory_as_text, memory_from_text
from camber.gnss.observations.base_offset import BaseOffset
from camber.gnss.service import GnssService
from camber.gnss.settings import GnssSettings
from camber.runtime.bus import Bus
from camber.schemas.gnss import ReceiverBytes
from support.gnss_bus import GnssBus
from support.raw_drive import RawDrive
from support.state_files import content_of, write_state

NS = 1_000_000_000
RIGHT = BaseOffset(enu_m=(0.4, -0.3, 1.0), sigma_m=(1.0, 1.1, 4.9), chi2=0.3)


class Run:
    """The service with its engine and a state folder, over the first epochs of a drive."""

    def __init__(self, drive: RawDrive, folder: Path, epochs: int = 3, **settings: Any) -> None:
        self.bus = GnssBus(drive.times_ns[0] - NS)
        made = GnssSettings(positions="engine", state_dir=folder, **settings)
        self.service = GnssService(made, cast(Bus, self.bus))
        for k in range(epochs):
            now_ns = self.bus.time_ns = drive.times_ns[k] + NS // 20
            for stream, protocol, data in (
                ("base", "rtcm", drive.rtcm_parts[k]),
                ("rover", "ubx", drive.ubx_parts[k]),
            ):
                payload = np.frombuffer(data, np.uint8)
                message = ReceiverBytes(
                    time_ns=now_ns, stream=cast(Any, stream), protocol=cast(Any, protocol), payload=payload
                )
                self.service.handlers()["receiver_bytes"](message)
            self.service.advance(now_ns)

    @property
    def base(self) -> Any:
        assert self.service._rover is not None
        return self.service._rover.engine.base


def remembered(drive: RawDrive, folder: Path, north_m: float = 0.0) -> Path:
    """A file of yesterday with the drive's station, that far south of where it says now."""
    run = Run(drive, folder)
    station, memory = run.base.name.partition("@")[0], BaseMemory()
    moved_m = run.base.position_ecef_m - np.array([0.0, 0.0, north_m])
    memory.remember("bus", station, moved_m, time_ns=drive.times_ns[0] - 86_400 * NS, offset=RIGHT)
    return write_state(folder, "bases", memory_as_text(memory.bases))


def test_a_station_where_it_was_yesterday_gives_fixes(raw_drive: RawDrive, tmp_path: Path) -> None:
    remembered(raw_drive, tmp_path)
    run = Run(raw_drive, tmp_path)
    assert run.bus.qualities() == ["fixed"] * 3
    assert run.bus.issues == []


def test_a_station_that_moved_gives_no_fixes_until_its_name_is_confirmed(
    raw_drive: RawDrive, tmp_path: Path
) -> None:
    remembered(raw_drive, tmp_path, north_m=1.7)
    run = Run(raw_drive, tmp_path)
    assert run.bus.qualities() == ["single"] * 3
    assert run.bus.counters["not_fixed.base_moved"] == 3
    text = run.bus.named()["base_moved"]
    assert text.endswith(f"on 1 earlier day; confirmed_bases accepts {run.base.name}")
    assert " m north, " in text
    assert Run(raw_drive, tmp_path).bus.qualities() == ["single"] * 3, "also after a restart"
    confirmed = Run(raw_drive, tmp_path, confirmed_bases=(run.base.name,))
    assert confirmed.bus.qualities() == ["fixed"] * 3
    assert memory_from_text(content_of(tmp_path, "bases")).bases == []
    given = run.base.position_ecef_m.tolist()
    assert Run(raw_drive, tmp_path, base_ecef_m=tuple(given)).bus.qualities() == ["fixed"] * 3


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b'{"format":2,"bases":[]}', b"null"])
def test_a_damaged_file_is_one_line_and_an_empty_memory(
    content: bytes, raw_drive: RawDrive, tmp_path: Path
) -> None:
    (tmp_path / "bases.json").write_bytes(content)
    run = Run(raw_drive, tmp_path)
    assert run.bus.qualities() == ["fixed"] * 3
    (issue,) = run.bus.issues
    assert issue[0] == "state_rejected"
    assert "\n" not in issue[1]


def test_what_is_new_is_written_and_a_folder_that_cannot_be_is_reported(
    raw_drive: RawDrive, tmp_path: Path
) -> None:
    run = Run(raw_drive, tmp_path)
    assert not (tmp_path / "bases.json").exists()
    run.base.offset = RIGHT
    assert run.service._rover is not None
    run.service._rover.bases.remember(run.base)
    run.service.advance(run.bus.time_ns)
    kept = memory_from_text(content_of(tmp_path, "bases"))
    assert [base.station for base in kept.bases] == [run.base.name.partition("@")[0]]
    (tmp_path / "a file").write_text("")
    blocked = Run(raw_drive, tmp_path / "a file")
    blocked.base.offset = RIGHT
    assert blocked.service._rover is not None
    blocked.service._rover.bases.remember(blocked.base)
    blocked.service.advance(blocked.bus.time_ns)
    assert "state_not_saved" in blocked.bus.named()


_WRITER = """
import sys
from pathlib import Path
from camber.runtime.settings import ServiceSettings
from camber.runtime.state_file import StateFile
file = StateFile("bases", settings=ServiceSettings(state_dir=Path(sys.argv[1]).parent), bus=None)
content = file.load(str)
print("ready", flush=True)
while True:
    file.save(content)
"""


def test_a_process_killed_while_it_writes_leaves_a_whole_file(raw_drive: RawDrive, tmp_path: Path) -> None:
    path = remembered(raw_drive, tmp_path)
    before = path.read_text("utf-8")
    for _ in range(5):
        with subprocess.Popen(
            [sys.executable, "-c", _WRITER, str(path)], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            os.kill(process.pid, signal.SIGKILL)
        assert path.read_text("utf-8") == before
