"""`camber lab` from the command line."""

from __future__ import annotations

import json
import pickle
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from camber.validation.lab import command as lab
from camber.validation.lab.error_model import HEADLINE
from camber.validation.lab.false_alarms import alarms_block
from camber.validation.lab.html_page import lab_html
from camber.validation.lab.missed_detection import MissedDetections, missed_block
from camber.validation.lab.page import page
from camber.validation.lab.work_blocks import WorkBlock, workers


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("lab")
    assert lab.main(["--trials", "60", "--seed", "3", "--processes", "1", "--out", str(out)]) == 0
    return out


def test_a_run_leaves_figures_tables_and_a_page(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == {"lab.json", "lab.md", "lab.html"}
    figures = json.loads((folder / "lab.json").read_text("utf-8"))
    assert figures["seed"] == 3
    assert {row["kind"] for row in figures["missed"]} == {"search", "cycles"}


def test_how_many_processes_there_are_changes_no_figure() -> None:
    scenes, blocks = HEADLINE[:1], [WorkBlock(seed=3, number=number, skies=4) for number in range(3)]
    tasks = [
        *(partial(missed_block, block, "cycles", scenes) for block in blocks),
        partial(alarms_block, WorkBlock(seed=3, number=0, skies=20, repeats=2), scenes),
    ]
    with workers(1) as alone, workers(2) as shared:
        one, two = list(alone(tasks)), list(shared(tasks))
    assert pickle.dumps(one[3]) == pickle.dumps(two[3])
    for by_one, by_two in zip(one[:3], two[:3], strict=True):
        for name in MissedDetections.__slots__:
            assert np.array_equal(getattr(by_one[0], name), getattr(by_two[0], name))
    assert not np.array_equal(one[0][0].in_bin, one[1][0].in_bin)


def test_the_page_comes_from_the_figures_alone(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert lab.main(["--page", str(folder / "lab.json")]) == 0
    printed = capsys.readouterr().out
    assert printed == (folder / "lab.md").read_text("utf-8")
    assert "camber lab --seed 3 --trials 60" in printed
    for text in ("always no", "hazardously misleading", "false_alarm_rate", "effective events"):
        assert text in printed


def test_a_requirement_that_is_not_met_is_marked(folder: Path) -> None:
    figures = json.loads((folder / "lab.json").read_text("utf-8"))
    figures["hazard"]["upper_95"] = 2e-7
    figures["alarms"][0]["false_alarm"]["upper_95"] = 0.9e-5
    rows = [row for row in page(figures).splitlines() if "hazardously" in row or "false alarms" in row]
    assert any("hazardously" in row and "**no**" in row for row in rows)
    assert any("LiDAR σ 0.05 m" in row and row.endswith("yes |") for row in rows)


def test_the_html_page_has_all_tables_and_names_too_few_episodes(folder: Path) -> None:
    html = (folder / "lab.html").read_text("utf-8")
    tables = (folder / "lab.md").read_text("utf-8").count("\n| --- |")
    assert html.count("<table>") == tables > 5
    assert "60 episodes of each kind cannot show a rate of 1e-4: 30,000 are needed (3/n)." in html
    assert "<strong>no</strong>" in html
    figures = json.loads((folder / "lab.json").read_text("utf-8"))
    assert "cannot show" not in lab_html(figures | {"trials": 30_000})


@pytest.mark.parametrize("content", ["{", "{}", '{"missed": 3}'])
def test_a_file_that_is_no_run_of_the_lab_is_one_line(
    content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.json"
    path.write_text(content, "utf-8")
    assert lab.main(["--page", str(path)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"camber lab: {path}")
    assert printed.err.count("\n") == 1


def test_no_trials_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        lab.main(["--trials", "0"])
    assert "--trials: '0', expected a whole number from 1 to" in capsys.readouterr().err
