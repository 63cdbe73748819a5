"""`camber live`: what it refuses to serve."""

from __future__ import annotations

from pathlib import Path

import pytest

from camber.live.command import main
from camber.replay.run_folder import DriveFacts, RunFolder


@pytest.mark.parametrize(
    ("arguments", "refusal"),
    [
        (["--host", "0.0.0.0"], "--token is needed"),
        (["--host", "0.0.0.0", "--token", "short"], "at least 16 characters"),
        (["missing.mcap", "--host", "0.0.0.0", "--published-on-loopback"], "missing.mcap"),
        (["--certificate", "a.pem"], "expected both or none"),
        (["--raster", "file:///tiles"], "expected an address"),
        (["missing.mcap"], "missing.mcap"),
        (["missing.mcap", "--map", "nowhere"], "missing.mcap"),
    ],
)
def test_wrong_usage_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: list[str], refusal: str
) -> None:
    monkeypatch.delenv("CAMBER_LIVE_TOKEN", raising=False)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert refusal in error
    assert error.count("\n") == 1


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path)]) == 2
    assert "drive.json" in capsys.readouterr().err


def test_the_map_of_a_run_is_that_of_its_folder(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    within = DriveFacts(drive="d", truth=False, map_release="city/map")
    assert folder.map_release(within) == tmp_path / "city" / "map"
    assert folder.map_release(within.model_copy(update={"map_release": "/maps/town"})) == Path("/maps/town")
    assert folder.map_release(DriveFacts(drive="d", truth=False)) is None
