"""Every way in which a command over one drive fails has a line and a code."""

from __future__ import annotations

from pathlib import Path

import pytest

from camber.formats.errors import FormatError
from camber.replay.command import StoppedBySignal
from camber.replay.lock_step.feeder import ReplayStuckError
from camber.runtime.session import BusError
from camber.runtime.settings import ConfigError
from camber.schemas.drive import ManifestError
from camber.tools.options.error_report import report_failures


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (ManifestError("drive.toml: bad"), 2),
        (FormatError("rover.pos", "datum", "WGS84"), 2),
        (ConfigError("way: unknown"), 2),
        (OSError(28, "No space left on device"), 2),
        (OSError("no number"), 2),
        (ReplayStuckError("tick 7 not done"), 1),
        (BusError("cannot join"), 1),
        (StoppedBySignal(), 130),
        (KeyboardInterrupt(), 130),
    ],
)
def test_every_failure_has_a_line_and_a_code(
    fault: BaseException, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def work() -> int:
        raise fault

    assert report_failures("camber replay", tmp_path, work) == code
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("camber replay: ")
    assert not line.endswith("None")
    assert line.endswith(f"see {tmp_path / 'logs'}") == (code == 1)
    assert report_failures("camber feed", tmp_path, work, bus_code=3) == (3 if code == 1 else code)
    assert "logs" not in capsys.readouterr().err


def test_a_programming_error_is_raised(tmp_path: Path) -> None:
    def work() -> int:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        report_failures("camber replay", tmp_path, work)


def test_success_keeps_its_code_and_a_text_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report_failures("camber replay", tmp_path, lambda: 7) == 7
    assert report_failures("camber replay", tmp_path, lambda: "done") == 0
    assert capsys.readouterr() == ("done\n", "")
