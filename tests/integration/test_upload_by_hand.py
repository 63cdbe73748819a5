"""`camber upload`: a file goes to the store, each batch once, and each file hears what became of it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from support.running import camber, free_port, started
from support.tree import ROOT

EXAMPLE = ROOT / "examples" / "uploads.csv"


@pytest.fixture
def cloud(tmp_path: Path) -> Iterator[str]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    bus = ("--vehicle", "fleet", "--zenoh.connect", f'["{endpoint}"]')
    with (
        (tmp_path / "log").open("w") as log,
        started("-m", "camber.cli", "router", "--listen", endpoint, stdout=log),
        started("-m", "camber.cli", "map_update", *bus, "--state-dir", tmp_path / "state", stdout=log),
    ):
        yield endpoint


def test_files_are_acknowledged_and_what_comes_again_is_known(tmp_path: Path, cloud: str) -> None:
    other = tmp_path / "other.csv"
    other.write_text(EXAMPLE.read_text().replace("monday", "tuesday"))
    first = camber("upload", EXAMPLE, other, "--connect", cloud)
    assert first.returncode == 0, first.stderr
    assert first.stdout.splitlines() == [
        f"{path}: 12 observations in 3 batches: 12 stored" for path in (EXAMPLE, other)
    ]
    stored = camber("uploads", tmp_path / "state/uploads.sqlite", "--records").stdout
    assert len(stored.splitlines()) == 1 + 24
    # What the store gives is what it takes.
    again = tmp_path / "again.csv"
    again.write_text(stored)
    second = camber("upload", again, "--connect", cloud)
    assert (second.returncode, second.stdout) == (
        0,
        f"{again}: 24 observations in 6 batches: 24 duplicate\n",
    ), second.stderr


def test_what_is_refused_or_wrong_says_so(tmp_path: Path, cloud: str) -> None:
    foreign = tmp_path / "foreign.csv"
    foreign.write_text(EXAMPLE.read_text().replace("ITRF2014", "NAD83"))
    refused = camber("upload", foreign, "--connect", cloud)
    assert refused.returncode == 1
    assert "12 refused" in refused.stdout
    assert "car-1 monday-1: refused: datum NAD83, expected one of" in refused.stderr
    foreign.write_text(EXAMPLE.read_text().replace(",fixed,", ",firm,", 1))
    wrong = camber("upload", EXAMPLE, foreign, "--connect", cloud)
    assert wrong.returncode == 2
    assert (wrong.stdout, wrong.stderr.count("\n")) == ("", 1), "nothing is sent where one file is wrong"


def test_nobody_there_is_one_line() -> None:
    alone = camber("upload", EXAMPLE, "--timeout", "1", "--connect", f"tcp/127.0.0.1:{free_port()}")
    assert (alone.returncode, alone.stdout) == (1, "")
    assert alone.stderr.startswith("camber upload: cannot join the bus")
    assert alone.stderr.count("\n") == 1
