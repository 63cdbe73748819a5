"""The notebooks run from top to bottom, as a person who opens them does it, and print what their texts say."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from support.running import python
from support.tree import ROOT

NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
PRINTED = {
    "judge_fixes": ["496 fixes, 71 of them wrong by more than 0.5 m", "400 confirmed, 0 of them wrong"],
    "judge_one_by_one": ["True", "confirmed height_agrees +0.0", "erroneous height_"],
    "road_map": [
        "datum WGS84, map version 1",
        "levels_ambiguous",
        "antenna above the road: median 1.57 m, spread 0.03 m",
    ],
}


def cells(notebook: Path, kind: str) -> list[str]:
    """The sources of a notebook's cells of one kind."""
    table = json.loads(notebook.read_text("utf-8"))
    return ["".join(cell["source"]) for cell in table["cells"] if cell["cell_type"] == kind]


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_prints_what_it_says(notebook: Path, tmp_path: Path) -> None:
    script = tmp_path / "notebook.py"
    script.write_text("\n\n".join(cells(notebook, "code")), "utf-8")
    folder = os.path.dirname(sys.executable)
    environment = os.environ | {"MPLBACKEND": "Agg", "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}
    done = python(script, cwd=tmp_path, env=environment, timeout_s=120.0)
    assert (done.returncode, done.stderr) == (0, "")
    for text in PRINTED[notebook.stem]:
        assert text in done.stdout


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_committed_without_output_and_begins_with_what_it_is(notebook: Path) -> None:
    table = json.loads(notebook.read_text("utf-8"))
    assert not [cell for cell in table["cells"] if cell.get("outputs") or cell.get("execution_count")]
    assert cells(notebook, "markdown")[0].startswith("# ")
    assert "pip install" in cells(notebook, "markdown")[0]
