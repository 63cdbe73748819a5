"""A plain installation, without any extra: what needs none works, the rest names the extra in one line."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

EXTRAS = (
    "numba",
    "small_gicp",
    "matplotlib",
    "pandas",
    "hatanaka",
    "starlette",
    "asyncpg",
    "nats",
    "rasterio",
)


def camber(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run the command where importing what comes with an extra fails."""
    code = f"import sys; sys.modules.update(dict.fromkeys({EXTRAS}))\nfrom camber.cli import main\nsys.exit(main())"
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300.0, check=False)


@pytest.mark.slow
def test_the_short_demo_runs_and_gives_the_verdicts_of_a_full_installation(tmp_path: Path) -> None:
    done = camber("demo", "--short", "--out", "demo", cwd=tmp_path)
    errors = [
        line for line in done.stderr.splitlines() if not line.endswith(" s")
    ]  # of progress, on a slow machine
    assert (done.returncode, errors) == (0, [])
    summary = json.loads((tmp_path / "demo" / "summary.json").read_text("utf-8"))
    assert (summary["confirmed"]["count"], summary["confirmed"]["wrong"]) == (400, 0)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("demo", "--out", "city"), "camber demo: numba is not installed; it comes with camber[engine]"),
        (
            ("gnss", "solve", "a", "b", "c"),
            "camber gnss: matplotlib is not installed; it comes with camber[plots]",
        ),
        (("gnss", "--source", "bus"), "camber gnss: numba is not installed; it comes with camber[engine]"),
        (("live", "demo"), "camber live: starlette is not installed; it comes with camber[web]"),
    ],
)
def test_what_needs_an_extra_names_it_in_one_line(
    tmp_path: Path, arguments: tuple[str, ...], expected: str
) -> None:
    done = camber(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.splitlines() == [expected]
