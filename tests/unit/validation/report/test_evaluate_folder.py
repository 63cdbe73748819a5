"""`camber evaluate`: summary and report from a folder, or one line and exit code 2."""

from __future__ import annotations

import base64
import json
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from camber.formats.drive.mcap_recorder import Recorder
from camber.live.rows import TERMS
from camber.replay.run_folder import DriveFacts, RunFacts, RunFolder
from camber.schemas.base import Message
from camber.schemas.codec import encode
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Position, Verdict
from camber.schemas.motion import Motion
from camber.validation.evaluate import main
from camber.validation.evaluation import CHANNELS
from camber.validation.reference_trajectory import ReferenceTrajectory
from camber.validation.report import chart_data
from camber.validation.report.bundle import embedded_json

NS = 1_373_000_000_000_000_000
HOSTILE = '</script><script>alert(1)</script> & "x" {{data}} {{drive}}'
PLACE = {"latitude_rad": 0.6, "longitude_rad": 2.3, "height_m": 40.0}


def epoch(i: int) -> list[tuple[str, Message]]:
    """A right fix, confirmed; every tenth 3 m too high, erroneous."""
    time_ns = NS + i * 200_000_000
    high = i % 10 == 5
    place = PLACE | {"height_m": 43.0 if high else 40.0}
    fix = Fix(time_ns=time_ns, fix_id=i, origin="receiver", quality="fixed", covariance_enu_m2=None, **place)
    outcome, reason = ("erroneous", "height_disagrees") if high else ("confirmed", "height_agrees")
    verdict = Verdict(
        time_ns=time_ns, fix_id=i, verdict=outcome, reason=reason, tolerance_m=0.2,
        height_difference_m=-3.0 if high else 0.01,
    )  # fmt: skip
    position = Position(
        time_ns=time_ns, source="rtk", usable=True, alert_limit_m=1.5, semi_major_999_m=0.1,
        semi_minor_999_m=0.1, orientation_rad=0.0, **PLACE,
    )  # fmt: skip
    motion = Motion(time_ns=time_ns)
    return [("motion", motion), ("fix", fix), ("verdict", verdict), ("position", position)]


def make(path: Path, *, truth: bool = True, drive: str = "made", count: int = 300) -> RunFolder:
    folder = RunFolder(path)
    rows = max(1, count)
    times = NS + 200_000_000 * np.arange(rows, dtype=np.int64)
    reference = ReferenceTrajectory(
        time_ns=times,
        latitude_rad=np.full(rows, 0.6),
        longitude_rad=np.full(rows, 2.3),
        height_m=np.full(rows, 40.0),
    )
    facts = DriveFacts(drive=drive, surrogates=(HOSTILE,), truth=truth, alert_limit_m=1.5)
    folder.write_drive(facts, reference if truth else None)
    folder.write_run(RunFacts(speed_factor=50.0, wall_s=1.2))
    with Recorder(folder.recording_path) as recorder:
        for i in range(count):
            for channel, message in epoch(i):
                payload = encode(message, source="s", sequence=i)
                recorder.add(channel, payload, key=f"camber/v1/car/{channel}", arrival_ns=i)
            recorder.tick_done()
    return folder


def summary_of(folder: RunFolder) -> dict[str, object]:
    summary: dict[str, object] = json.loads(folder.summary_path.read_text("utf-8"))
    return summary


def test_summary_and_report_are_made_from_the_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make(tmp_path)
    assert main([str(tmp_path)]) == 0
    s = summary_of(folder)
    assert s["tentative"] == {"fixed": 300, "wrong": 30, "truth_unknown": 0}
    assert s["confirmed"] == {"count": 270, "wrong": 0, "truth_unknown": 0}
    assert s["right"] == {"count": 270, "kept": 1.0, "erroneous": 0}
    assert folder.report_path.exists()
    printed = capsys.readouterr().out
    assert "300 epochs, 300 fixes, 30 of them wrong" in printed
    assert "missed 0 of 30" in printed


def test_evaluating_again_gives_the_same_files(tmp_path: Path) -> None:
    folder = make(tmp_path)
    made = []
    for _ in range(2):
        main([str(tmp_path)])
        made.append((folder.summary_path.read_bytes(), folder.report_path.read_bytes()))
    assert made[0] == made[1]


@pytest.mark.parametrize("name", ["recording.mcap", "drive.json", "truth.npz"])
@pytest.mark.parametrize("accident", ["missing", "empty", "cut"])
def test_a_missing_or_damaged_file_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, accident: str
) -> None:
    make(tmp_path)
    path = tmp_path / name
    data = path.read_bytes()
    if accident == "missing":
        path.unlink()
    else:
        path.write_bytes(b"" if accident == "empty" else data[: len(data) // 2])
    assert main([str(tmp_path)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert name in err
    assert not (tmp_path / "summary.json").exists()


def test_no_folder_is_one_line_and_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "nowhere")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_part_of_a_recording_is_evaluated_only_when_asked_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make(tmp_path)
    data = folder.recording_path.read_bytes()
    folder.recording_path.write_bytes(data[: len(data) * 2 // 3])
    assert main([str(tmp_path), "--partial"]) == 0
    s = summary_of(folder)
    assert isinstance(s["epochs"], int)
    assert 0 < s["epochs"] < 300
    assert isinstance(s["damage"], list)
    assert len(s["damage"]) == 1
    assert "only partly read" in capsys.readouterr().err
    assert "Only part of the recording could be read" in folder.report_path.read_text("utf-8")


class _Page(HTMLParser):
    """Elements by name, their addresses, and the text outside scripts."""

    def __init__(self) -> None:
        super().__init__()
        self.elements: list[str] = []
        self.addresses: list[str] = []
        self.scripts: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "data", "action")]
        if tag == "script":
            self.scripts.append("")

    def handle_data(self, data: str) -> None:
        if self.lasttag == "script" and self.scripts:
            self.scripts[-1] += data
        else:
            self.text += data


def page_of(folder: RunFolder) -> _Page:
    main([str(folder.path)])
    page = _Page()
    page.feed(folder.report_path.read_text("utf-8"))
    return page


def test_untrusted_text_stays_text(tmp_path: Path) -> None:
    page = page_of(make(tmp_path, drive=HOSTILE))
    assert page.elements.count("script") == 3
    assert page.text.count(HOSTILE) >= 3  # title, heading, surrogates
    assert "alert(1)" not in page.scripts[2]  # the first two are data


def test_embedded_json_cannot_end_the_element_it_stands_in() -> None:
    text = embedded_json({"a": HOSTILE + "<!--"})
    assert not {"<", ">", "&"} & set(text)
    assert json.loads(text) == {"a": HOSTILE + "<!--"}


def test_the_report_fetches_nothing(tmp_path: Path) -> None:
    folder = make(tmp_path)
    page = page_of(folder)
    assert page.addresses == []
    assert not {"link", "img", "iframe", "object", "embed"} & set(page.elements)
    source = folder.report_path.read_text("utf-8")
    assert "default-src 'none'" in source


def tables_of(page: _Page) -> dict[str, dict[str, np.ndarray]]:
    """The rows of the page by table and column, read as the page reads them."""
    facts, data = json.loads(page.scripts[0]), base64.b64decode(page.scripts[1])
    length = int.from_bytes(data[:4], "little")
    at, tables = 4 + length, {}
    for header in json.loads(data[4:at])["tables"]:
        columns = facts["columns"][header["name"]]
        read = tables.setdefault(header["name"], {})
        for names, kind, size in ((columns["exact"], "<f8", 8), (columns["rest"], "<f4", 4)):
            at += -at % 8
            for name in names:
                read[name] = np.frombuffer(data, kind, header["rows"], at)
                at += size * header["rows"]
        at += -at % 8
    return tables


def test_the_charts_have_every_epoch_and_nan_for_what_is_not_known(tmp_path: Path) -> None:
    tables = tables_of(page_of(make(tmp_path)))
    assert {len(tables[name]["t"]) for name in ("fix", "verdict", "position", "truth")} == {300}
    verdict = tables["verdict"]
    assert verdict["error_m"][[4, 5]] == pytest.approx([0.0, 3.0])
    assert verdict["verdict"][5] == TERMS["verdict"].index("erroneous")
    assert np.isnan(tables["position"]["hpl_m"]).all()


def test_all_channels_that_are_evaluated_are_drawn() -> None:
    assert set(CHANNELS) <= set(chart_data.CHART_CHANNELS)


def test_of_many_epochs_some_are_left_out_but_none_with_a_wrong_fix(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chart_data, "MOST_EPOCHS", 100)
    page = page_of(make(tmp_path))
    verdict = tables_of(page)["verdict"]
    # One of three, and the 30 wrong ones, of which ten are among those.
    assert len(verdict["t"]) == 120
    assert (verdict["error_m"] > 2.0).sum() == 30
    assert "Charts show 120 of 300 epochs" in page.text


def test_the_report_of_a_drive_without_truth_says_not_known(tmp_path: Path) -> None:
    page = page_of(make(tmp_path, truth=False))
    assert json.loads(page.scripts[0])["truth"] is False
    assert np.isnan(tables_of(page)["verdict"]["error_m"]).all()
    assert "not known" in page.text
    assert "0 of 0" not in page.text


def test_the_report_of_an_empty_recording_can_be_made(tmp_path: Path) -> None:
    page = page_of(make(tmp_path, truth=False, count=0))
    assert "No verdict was recorded." in page.text
