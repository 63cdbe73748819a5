"""Differences of the methods in earlier drives: a changed tyre is detected, damaged files are reported."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest

from camber.antenna_height.change_detection import BLOCK_NS, ChangeDetector, ChangeRules, Reference
from camber.antenna_height.saved_state import references_as_text, references_from_text
from camber.antenna_height.service import AntennaHeightService
from camber.antenna_height.settings import AntennaHeightSettings
from camber.runtime.bus import Bus
from camber.schemas.antenna import AntennaHeight
from camber.schemas.motion import Motion, Suspension
from support.fake_bus import FakeBus

START_NS = 1_450_000_000 * 1_000_000_000
STEP_NS = 100_000_000
EARLIER = Reference(30.0, 0.020, 30.0 * 0.002**2)
BLOCK = BLOCK_NS // STEP_NS + 1


def watched(difference_m: float, blocks: int, earlier: Reference | None = EARLIER) -> ChangeDetector:
    detector = ChangeDetector(rules=ChangeRules(), earlier=earlier, earlier_least_m=0.015)
    for k in range(blocks * BLOCK):
        detector.add(START_NS + k * STEP_NS, difference_m)
    return detector


def test_a_difference_from_earlier_drives_is_detected_after_two_blocks() -> None:
    assert watched(0.040, 1).change is None
    change = watched(0.040, 2).change
    assert (change.by_m, change.since_ns) == (pytest.approx(0.020), START_NS)
    assert watched(0.040, 200).change is not None


def test_another_constant_error_of_a_sensor_is_no_change() -> None:
    assert watched(0.030, 200).change is None
    assert watched(0.040, 200, None).change is None


def test_the_older_reference_stands_until_what_contradicts_it_is_gone() -> None:
    detector = watched(0.040, 40)
    assert detector.reference is EARLIER
    for k in range(40 * BLOCK, 60 * BLOCK):
        detector.add(START_NS + k * STEP_NS, 0.022)
    assert detector.change is None


def test_a_drive_that_agrees_is_remembered_with_the_earlier_ones() -> None:
    reference = watched(0.026, 25).reference
    assert reference.blocks == pytest.approx(30.0 + 20.0, abs=1.0)
    assert 0.022 < reference.mean_m < 0.023
    assert watched(0.026, 5000).reference.blocks <= 451.0


def test_means_of_two_drives_are_those_of_all_blocks() -> None:
    values = [0.01, 0.013, 0.008, 0.02, 0.017, 0.011]
    parts = [Reference(), Reference(), Reference()]
    for k, value in enumerate(values):
        parts[k >= 2] = parts[k >= 2].add(value)
        parts[2] = parts[2].add(value)
    both = parts[0].merged(parts[1])
    assert (both.blocks, both.mean_m) == (6.0, pytest.approx(parts[2].mean_m))
    assert both.squares_m2 == pytest.approx(parts[2].squares_m2)
    assert Reference().merged(Reference()) == Reference()


SETTINGS = AntennaHeightSettings(
    way="stroke", suspension_to_antenna_m=0.92, tyre_radius_m=0.31, fixed_height_m=1.58
)


def test_text_is_read_back_for_the_same_vehicle_only() -> None:
    vehicle = SETTINGS.options().vehicle
    references = {("fixed", "stroke"): EARLIER}
    text = references_as_text(vehicle, references)  # type: ignore[arg-type]
    assert references_from_text(text, vehicle) == references
    assert references_from_text(text, replace(vehicle, stored_sigma_m=0.02)) == {}


def changed(**changes: object) -> str:
    """The text of one difference, with fields of it changed."""
    table = json.loads(references_as_text(SETTINGS.options().vehicle, {("fixed", "stroke"): EARLIER}))
    table["pairs"][0] |= changes
    return json.dumps(table)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "\x00" * 40,
        changed(methods=["fixed"]),
        changed(methods=["fixed", "fixed"]),
        changed(mean_m=10.1),
        changed(mean_m=float("nan")),
        changed(blocks=0.0),
        changed(blocks=452.0),
        changed(squares_m2=3001.0),
        json.dumps({**json.loads(changed()), "pairs": 2 * json.loads(changed())["pairs"]}),
    ],
    ids=lambda text: text[-60:],
)
def test_text_with_values_out_of_their_bounds_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        references_from_text(text, SETTINGS.options().vehicle)


def test_what_is_not_plausible_is_not_kept() -> None:
    vehicle = SETTINGS.options().vehicle
    text = references_as_text(
        vehicle, {("fixed", "stroke"): Reference(), ("fixed", "ranging"): Reference(9.0, 11.0)}
    )
    assert references_from_text(text, vehicle) == {}


class HeightBus(FakeBus):
    last: AntennaHeight

    def publish(self, name: str, message: AntennaHeight) -> None:
        self.last = message


def driven(folder: Path, stroke_m: float, *, begin_s: int = 0, **more: object) -> HeightBus:
    """Forty seconds of driving with the service, which is then ended."""
    bus = HeightBus()
    settings = SETTINGS.model_copy(update={"state_dir": folder, **more})
    service = AntennaHeightService(settings, cast(Bus, bus))
    handlers = service.handlers()
    for k in range(400):
        now_ns = START_NS + begin_s * 1_000_000_000 + k * STEP_NS
        handlers["motion"](Motion(time_ns=now_ns, wheel_speed_m_s=10.0))
        handlers["suspension"](Suspension(time_ns=now_ns, stroke_height_m=stroke_m, stroke_sigma_m=0.005))
        service.advance(now_ns)
    service.close()
    return bus


def test_a_change_between_two_drives_is_a_disagreement_until_it_is_measured(tmp_path: Path) -> None:
    assert driven(tmp_path, 0.35).last.status == "known"
    assert driven(tmp_path, 0.37, begin_s=1000).last.status == "disagreement"
    assert driven(tmp_path, 0.37, begin_s=2000).last.status == "disagreement"
    assert driven(tmp_path, 0.35, begin_s=3000).last.status == "known"
    assert driven(tmp_path, 0.37, begin_s=4000, tyre_radius_m=0.305).last.status == "known"


def test_a_damaged_file_is_one_issue_and_the_next_is_whole(tmp_path: Path) -> None:
    (tmp_path / "differences.json").write_bytes(b"\xff\x00{")
    assert [code for code, _ in driven(tmp_path, 0.35).issues] == ["state_rejected"]
    assert driven(tmp_path, 0.35, begin_s=1000).issues == []
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["differences.json", "differences.json.corrupt"]


def test_where_nothing_can_be_written_the_height_is_known_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    bus = driven(tmp_path / "file", 0.35)
    assert bus.last.status == "known"
    assert bus.codes() == {"state_not_saved"}
