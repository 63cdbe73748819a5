"""A simulated drive goes through all processes: every fix is judged, and a wrong one is not passed on."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from camber.formats.drive.truth_csv import read_truth
from camber.simulator.scenario import load_scenario
from camber.tools.simulate import simulate
from support.running import camber, in_one_process, recorded, replayed, summary_of


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A canyon with a base station that is wrong for a while, replayed."""
    folder = tmp_path_factory.mktemp("simulated")
    fault = '{kind = "wrong_base", onset_s = 30.0, end_s = 34.0, east_m = 3.0, up_m = 2.5}'
    scenario = load_scenario("canyon", ["duration_s=45.0", f"faults=[{fault}]"])
    manifest = simulate(scenario, folder / "drive", quiet=True)
    return replayed(manifest, folder / "out")


def test_every_epoch_and_every_sensor_is_on_the_bus(out: Path) -> None:
    messages = recorded(out)
    assert len(messages["fix"]) == pytest.approx(451, abs=3)
    for name in ("motion", "suspension", "ranging", "pose", "antenna_height"):
        assert len(messages[name]) == pytest.approx(450, rel=0.03), (
            name
        )  # the ranging sensor loses one in a hundred
    verdicts = [item.message for item in messages["verdict"] if item.message.fix_id is not None]
    fixes = sorted(item.message.fix_id for item in messages["fix"])
    # The pose that goes with the very last fix would have come after the end.
    assert sorted(v.fix_id for v in verdicts) in (fixes, fixes[:-1])


def test_the_summary_has_the_truth_and_names_the_simulated_map_alone(out: Path) -> None:
    summary = summary_of(out)
    (surrogate,) = summary["surrogates"]
    assert surrogate.startswith("map: simulated survey")
    assert summary["truth"] is True


def test_right_fixes_are_passed_on_and_those_of_a_wrong_base_are_not(out: Path) -> None:
    summary = summary_of(out)
    truth = read_truth(out.parent / "drive" / "truth.csv", "camber")
    wrong = set(truth.time_ns[truth.fix_state == 1].tolist())
    assert len(wrong) >= 20  # of forty epochs; the rest has no fix
    verdict_counts = Counter(
        item.message.verdict for item in recorded(out)["verdict"] if item.message.time_ns in wrong
    )
    assert not verdict_counts.keys() & {"confirmed", "confirmed_after_verification"}
    assert summary["confirmed"]["wrong"] == 0
    assert summary["right"]["kept"] > 0.8


def test_a_process_that_the_scenario_drops_is_killed_and_comes_back(tmp_path: Path) -> None:
    fault = '{kind = "dropped_process", onset_s = 12.0, service = "localizer"}'
    scenario = load_scenario("open-sky", ["duration_s=40.0", f"faults=[{fault}]"])
    manifest = simulate(scenario, tmp_path / "drive", quiet=True)
    # At twice its own speed, so that there is time to come back.
    done = camber("replay", manifest, "--processes", "--out", tmp_path / "out", "--speed", 2, timeout_s=150.0)
    assert done.returncode == 0, done.stderr
    first_ns = scenario.start_ns
    verdicts = [item.message for item in recorded(tmp_path / "out")["verdict"]]
    after = [v for v in verdicts if v.time_ns >= first_ns + 12 * 10**9]
    absent = [k for k, v in enumerate(after) if v.reason == "localizer_absent"]
    assert absent
    assert absent[0] < 5
    assert after[-1].verdict == "confirmed"
    assert (
        "localizer ended (signal SIGKILL) and was started again"
        in done.stdout
        + done.stderr
        + str(summary_of(tmp_path / "out"))
        + (tmp_path / "out" / "run.json").read_text()
    )


def test_after_a_jump_of_the_receivers_clock_fixes_are_confirmed_at_once(tmp_path: Path) -> None:
    fault = '{kind = "time_jump", onset_s = 15.0, end_s = 20.0, offset_s = 3.0}'
    scenario = load_scenario("open-sky", ["duration_s=24.0", "satellites.streams=false", f"faults=[{fault}]"])
    manifest = simulate(scenario, tmp_path / "drive", quiet=True)
    tenths = {
        round((item.message.time_ns - scenario.start_ns) / 1e8)
        for item in in_one_process(manifest, tmp_path).recorded["verdict"]
        if item.message.fix_id is not None and item.message.verdict == "confirmed"
    }
    assert tenths >= set(range(120, 150))
    # Dated 3 s ahead: refused, each of them, and none is taken for one of three seconds later.
    assert not [tenth for tenth in tenths if 150 <= tenth < 200]
    assert min(tenth for tenth in tenths if tenth >= 200) <= 202
    assert len(tenths & set(range(200, 230))) >= 27


def test_the_engine_solves_the_same_drive_and_is_judged_as_a_receiver_is(out: Path, tmp_path: Path) -> None:
    manifest = out.parent / "drive" / "drive.toml"
    replayed(manifest, tmp_path, "--processes", "--set", "positions=engine", timeout_s=400.0)
    messages, of_receiver = recorded(tmp_path), recorded(out)
    fixes = [item.message for item in messages["fix"]]
    assert {fix.origin for fix in fixes} == {"engine"}
    assert all(fix.covariance_enu_m2 is not None for fix in fixes)
    fixed = [fix for fix in fixes if fix.quality == "fixed"]
    assert len(fixed) > sum(item.message.quality == "fixed" for item in of_receiver["fix"])
    assert any(fix.ambiguity_continuity == "continuous" for fix in fixed)
    verdicts = [item.message for item in messages["verdict"]]
    again = [verdict for verdict in verdicts if "estimates" in verdict.evidence]
    assert again  # other estimates, asked for and answered within the tick
    assert all(verdict.verdict == "confirmed" and verdict.trials > 1 for verdict in again)
    velocities = [item.message for item in messages["velocity"]]
    assert len(velocities) > 0.8 * len(fixes)
    assert any(velocity.heading_rad is not None for velocity in velocities)
    summary = summary_of(tmp_path)
    assert summary["confirmed"]["wrong"] == 0
    assert summary["right"]["kept"] > 0.9
