"""`camber play`: what of a recording is played, and what is refused before the bus is joined."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from camber.formats.drive.mcap_recorder import Recorder
from camber.schemas.codec import encode
from camber.schemas.fleet import ReleaseHead
from camber.schemas.motion import Motion
from camber.tools.record import play as tool
from support.messages import build
from support.refusals import Refused

T = 1_400_000_000 * 10**9


def recording(path: Path, *keys: str, releases: int = 0) -> Path:
    """A motion under each key, 10 ms apart, and notices of a release that is a year old."""
    with Recorder(path) as recorder:
        for n, key in enumerate(keys):
            message = Motion(time_ns=T + n * 10_000_000, wheel_speed_m_s=1.0, yaw_rate_rad_s=0.0)
            recorder.add("motion", encode(message, source="vehicle", sequence=n), key=key, arrival_ns=0)
        head = build(ReleaseHead, Random(1), filled=True).model_copy(update={"time_ns": T - 3 * 10**16})
        for n in range(releases):
            data = encode(head, source="map_update", sequence=n)
            recorder.add("release", data, key="camber/v1/fleet/release", arrival_ns=0)
    return path


def motion_of(vehicle: str) -> str:
    return f"camber/v1/{vehicle}/vehicle/motion"


def test_recordings_of_two_vehicles_are_not_mixed(tmp_path: Path, refused: Refused) -> None:
    one, two = (recording(tmp_path / f"{name}.mcap", motion_of(name)) for name in ("c1", "c2"))
    both = recording(tmp_path / "both.mcap", motion_of("c1"), motion_of("c2"))
    for files in ([one, two], [both]):
        named = ", ".join(map(str, files))
        line = refused(tool.main, *files, "--vehicle", "bench")
        assert line == f"camber play: {named}: messages of c1, c2, expected one vehicle"


@pytest.mark.parametrize("key", ["motion", "a/b", "camber/v1/*/vehicle/motion"])
def test_a_key_that_names_no_vehicle_is_one_line(tmp_path: Path, key: str, refused: Refused) -> None:
    path = recording(tmp_path / "x.mcap", key)
    assert refused(tool.main, path).startswith(f"camber play: {path}: motion: key {key!r}: expected")


@pytest.mark.parametrize("times", ["now", "recorded"])
def test_what_is_not_the_vehicle_s_to_say_is_counted_and_not_waited_for(
    endpoint: str, tmp_path: Path, times: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recording(tmp_path / "c1.mcap", motion_of("c1"), motion_of("c1"), releases=3)
    assert tool.main([str(path), "--connect", endpoint, "--times", times]) == 0
    assert capsys.readouterr().out == "played motion 2; left out: release 3\n"
    assert tool.main([str(path), "--connect", endpoint, "--times", times, "--channels", "motion"]) == 0
    assert capsys.readouterr().out == "played motion 2\n"
