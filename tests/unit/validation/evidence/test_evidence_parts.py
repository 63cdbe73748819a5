"""What the parts of the evidence count: blocks of a drive, faults in a truth, indications in windows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from camber.formats.drive.truth_csv import TruthTable
from camber.replay.single_process_replay import DriveOutput, ReportedIssue
from camber.simulator.injected_faults import Fault
from camber.validation.evidence import command as evidence
from camber.validation.evidence.faults import (
    NAMED_BY,
    FaultIndication,
    FaultWindow,
    during,
    fault_windows,
    indications_of,
    named_until_ns,
)
from camber.validation.evidence.simulated_drives import BLOCK_S, block_counts, stacked_blocks
from camber.validation.protection_level_statistics import Positions

NS = 1_000_000_000


def positions(error_m: list[float], source: list[str], axis_m: float = 1.0) -> Positions:
    """Epochs at a quarter of a block each, errors to the east, round ellipses."""
    n = len(error_m)
    nan, ones = np.full(n, np.nan), np.full(n, axis_m)
    error_enu_m = np.column_stack((error_m, np.zeros(n), np.zeros(n)))
    columns = dict.fromkeys(Positions.__dataclass_fields__, nan) | {
        "time_ns": (np.arange(n) * BLOCK_S / 4 * NS).astype(np.int64),
        "source": np.array(source),
        "semi_major_999_m": ones,
        "semi_minor_999_m": ones,
        "orientation_rad": np.zeros(n),
        "error_enu_m": error_enu_m,
    }
    return Positions(**columns)


def test_a_block_counts_epochs_errors_and_what_lies_in_the_ellipses() -> None:
    made = positions([0.1, 0.9, 1.2, 1.7, 2.5], ["rtk", "sensors", "sensors", "sensors", "rtk"])
    counted = block_counts(made, made.time_ns)
    # Epochs, with an error, below 1.0, 1.5 and 2.0 m.
    assert counted["errors"] == [[4, 4, 2, 3, 4], [1, 1, 0, 0, 0]]
    # The 99 % ellipse reaches to 0.816 of the 99.9 % one.
    assert counted["modes"]["sensors"] == [[3, 0, 1], [0, 0, 0]]
    assert counted["modes"]["rtk"] == [[1, 1, 1], [1, 0, 0]]
    assert counted["modes"]["doppler"] == [[0, 0, 0], [0, 0, 0]]


def test_an_epoch_without_a_position_counts_against_availability_alone() -> None:
    made = positions([0.1, np.nan], ["rtk", "none"])
    assert block_counts(made, made.time_ns)["errors"] == [[2, 1, 1, 1, 1]]


def test_a_position_farther_from_an_epoch_than_half_a_step_is_not_of_it() -> None:
    made = positions([0.1, 0.1, 0.1, 0.1], ["rtk"] * 4)
    step_ns = int(BLOCK_S / 4 * NS)
    later_ns = np.append(made.time_ns + step_ns // 5, made.time_ns[-1] + step_ns)
    # The fifth epoch has none.
    assert np.sum(block_counts(made, later_ns)["errors"], axis=0).tolist() == [5, 4, 4, 4, 4]


def test_the_last_position_of_an_epoch_counts() -> None:
    """A receiver's clock is 2 ms off: before its fix came, the vehicle's sensors gave a position of the epoch."""
    sensors = positions([0.5] * 4, ["sensors"] * 4)
    fixes = positions([0.1] * 4, ["rtk"] * 4)
    both = {
        name: np.concatenate([np.asarray(getattr(made, name)) for made in (sensors, fixes)])
        for name in Positions.__dataclass_fields__
        if getattr(sensors, name) is not None
    }
    both["time_ns"][4:] += 2_000_000
    order = np.argsort(both["time_ns"], kind="stable")
    made = Positions(**{name: column[order] for name, column in both.items()})
    counted = block_counts(made, sensors.time_ns)
    assert counted["modes"]["rtk"] == [[4, 4, 4]]
    assert counted["modes"]["sensors"] == [[0, 0, 0]]
    assert counted["errors"] == [[4, 4, 4, 4, 4]]


def test_a_drive_without_positions_has_epochs_that_lack_them() -> None:
    counted = block_counts(positions([], []), np.arange(3, dtype=np.int64) * NS)
    assert counted["errors"] == [[3, 0, 0, 0, 0]]
    assert counted["modes"]["rtk"] == [[0, 0, 0]]


def test_blocks_of_several_drives_stand_one_after_the_other() -> None:
    made = [positions([0.1] * n, ["rtk"] * n) for n in (4, 8)]
    counted = [block_counts(drive, drive.time_ns) for drive in made]
    assert stacked_blocks(counted, None).shape == (3, 5)
    assert stacked_blocks(counted, "rtk").sum() == 36
    assert stacked_blocks([], None).shape == (0, 5)


def truth_with(**faults: list[float]) -> TruthTable:
    n = len(next(iter(faults.values())))
    place = dict.fromkeys(("latitude_rad", "longitude_rad", "height_m"), np.zeros(n))
    level = dict.fromkeys(("roll_rad", "pitch_rad", "yaw_rad"), np.zeros(n))
    more = {name: np.array(values) for name, values in faults.items()}
    times = np.arange(n, dtype=np.int64) * NS
    return TruthTable(time_ns=times, **place, **level, velocity_enu_m_s=np.zeros((n, 3)), more=more)


def test_each_time_that_a_fault_acts_is_a_window_in_the_order_of_time() -> None:
    truth = truth_with(
        fault_wrong_map=[0, 0, 1, 1, 0, 1], fault_jamming=[1, 0, 0, 0, 0, 0], map_wrong_m=[1, 1, 1, 1, 1, 1]
    )
    windows = [(w.kind, w.begin_ns // NS, w.end_ns // NS) for w in fault_windows(truth)]
    assert windows == [("jamming", 0, 0), ("wrong_map", 2, 3), ("wrong_map", 5, 5)]


def test_indications_in_a_window_are_counted_with_the_time_when_they_began() -> None:
    indications = [
        FaultIndication(at_s * NS, text) for at_s, text in ((10, "a"), (30, "b"), (31, "b"), (90, "b"))
    ]
    assert during(indications, 20 * NS, 50 * NS) == {"b": {"count": 2, "begun_s": 10.0}}


def test_what_lasts_from_before_a_window_names_nothing_in_it_until_it_has_ceased_and_begins_anew() -> None:
    lasting = [FaultIndication(k * NS, "cause antenna") for k in range(10)]
    assert during(lasting, 5 * NS, 9 * NS) == {"cause antenna": {"count": 5}}
    anew = [*lasting, FaultIndication(20 * NS, "cause antenna")]
    assert during(anew, 5 * NS, 20 * NS) == {"cause antenna": {"count": 6, "begun_s": 15.0}}


def test_indications_come_from_every_service_in_the_order_of_time() -> None:
    def at(time_ns: int, **fields: object) -> SimpleNamespace:
        return SimpleNamespace(message=SimpleNamespace(time_ns=time_ns, **fields))

    recorded = {
        "verdict": [at(5, reason="height_agrees", cause="none"), at(3, reason="common_offset", cause="base")],
        "scan_match": [at(1, status="converged"), at(2, status="lost")],
        "antenna_height": [at(4, status="disagreement"), at(6, status="known")],
        "pose": [at(7, reason="no speed; no rotation"), at(8, reason="")],
    }
    issue = ReportedIssue(time_ns=0, service="gnss", code="repeated_epoch", text="")
    driven = DriveOutput(recorded=recorded, issues=[issue])
    assert [indication.text for indication in indications_of(driven)] == [
        "gnss repeated_epoch",
        "match lost",
        "cause base",
        "verdict common_offset",
        "antenna_height disagreement",
        "verdict height_agrees",
        "pose: no rotation",
        "pose: no speed",
    ]


def test_a_fault_may_be_named_until_one_begins_that_the_same_indications_name() -> None:
    dropped, again, jump, silence = (
        FaultWindow(kind=kind, begin_ns=begin_s * NS, end_ns=end_s * NS)
        for kind, begin_s, end_s in (
            ("dropped_process", 10, 10),
            ("changed_road", 11, 20),
            ("time_jump", 30, 35),
            ("missing_epochs", 40, 45),
        )
    )
    assert named_until_ns(dropped, [again], 90 * NS) == 25 * NS
    assert named_until_ns(jump, [silence], 90 * NS) == 40 * NS - 1
    assert named_until_ns(silence, [], 50 * NS) == 50 * NS


def test_a_road_is_named_by_the_surfaces_reported_to_have_changed() -> None:
    verdict = SimpleNamespace(time_ns=5, reason="height_agrees", cause="road", surface_id=7)
    text = "surface 8 lies +0.30 m from map version 1"
    issue = ReportedIssue(time_ns=6, service="integrity", code="road_changed", text=text)
    driven = DriveOutput(recorded={"verdict": [SimpleNamespace(message=verdict)]}, issues=[issue])
    assert indications_of(driven) == [
        FaultIndication(5, "cause road", 7),
        FaultIndication(5, "verdict height_agrees"),
        FaultIndication(6, "integrity road_changed", 8),
    ]


def test_every_fault_that_can_be_simulated_has_what_names_it() -> None:
    union = get_args(Fault)[0]
    kinds = {get_args(kind.model_fields["kind"].annotation)[0] for kind in get_args(union)}
    assert kinds == set(NAMED_BY)


def test_without_recordings_the_page_says_that_they_were_skipped(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.delenv("CAMBER_DATA", raising=False)
    written = tmp_path / "evidence.md"
    arguments = ["--only", "nagoya", "--out", str(tmp_path), "--page", str(written), "--quiet"]
    assert evidence.main([*arguments, "--lab", str(tmp_path / "none.json")]) == 0
    assert "Nagoya was skipped: CAMBER_DATA is not set" in written.read_text("utf-8")
    assert "skipped" in capsys.readouterr().err


def test_a_drive_that_cannot_be_run_is_a_line_on_the_page_and_an_exit_code(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("CAMBER_DATA", str(tmp_path))
    written = tmp_path / "evidence.md"
    files = {"--nagoya": "none.toml", "--out": "", "--lab": "no.json", "--page": written.name}
    arguments = [text for option, name in files.items() for text in (option, str(tmp_path / name))]
    assert evidence.main([*arguments, "--only", "nagoya", "--seeds", "1", "--processes", "1", "--quiet"]) == 1
    assert "could not be run" in written.read_text("utf-8")


def test_the_page_alone_is_made_of_the_figures_that_are_there_and_drives_nothing(
    tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(evidence, "run_faults", None)
    (tmp_path / "faults").mkdir()
    (tmp_path / "faults" / "one.json").write_text(
        '{"scenario": "faults", "overrides": [], "seed": 4, "sweeps": 0, "wrong": 8, "confirmed_wrong": 0,'
        ' "right_kept": 0.5, "positions": "receiver", "faults": []}',
        "utf-8",
    )
    written = tmp_path / "evidence.md"
    arguments = ["--page-only", "--out", str(tmp_path), "--lab", str(tmp_path / "none.json")]
    assert evidence.main([*arguments, "--page", str(written), "--quiet"]) == 0
    assert "Wrong fixes 8, confirmed 0" in written.read_text("utf-8")
    with pytest.raises(SystemExit):
        evidence.main(arguments)
    assert "--page-only needs --page" in capsys.readouterr().err


def test_help_names_the_parts(capsys) -> None:
    with pytest.raises(SystemExit):
        evidence.main(["--help"])
    printed = capsys.readouterr().out
    assert all(part in printed for part in evidence.PARTS)
