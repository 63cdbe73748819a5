"""A state file is used where it is whole and this vehicle's, and else rejected, renamed and reported in one line."""

from __future__ import annotations

import hashlib
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.antenna_height.change_detection import Reference
from camber.antenna_height.saved_state import references_as_text, references_from_text
from camber.antenna_height.settings import AntennaHeightSettings
from camber.gnss.observations.base_coordinate_history import BaseMemory, memory_as_text, memory_from_text
from camber.gnss.observations.base_offset import BaseOffset
from camber.integrity.learning.height_correction import Correction, CorrectionState, Learning, LearningRules
from camber.integrity.learning.saved_state import from_text, to_text
from camber.localizer.given_pose import GivenPose
from camber.road_map.release_order import AcceptedRelease
from support.engine_drives import base_ecef_m
from support.fake_bus import NOW_NS, FakeBus
from support.state_files import content_of, state_file, write_state

NAMES = ("correction", "differences", "bases", "given_pose", "release")
VEHICLE = AntennaHeightSettings(fixed_height_m=1.58).options().vehicle


def _content(name: str) -> str:
    if name == "correction":
        part = CorrectionState(
            antenna="a",
            base="b",
            map_version=3,
            correction=Correction(correction_m=0.05, sigma_m=0.02, samples=7),
        )
        return to_text(Learning(LearningRules(), [part]))
    if name == "differences":
        return references_as_text(VEHICLE, {("fixed", "stroke"): Reference(30.0, 0.02, 1.2e-4)})
    if name == "bases":
        memory, right = BaseMemory(), BaseOffset(enu_m=(0.4, -0.3, 1.0), sigma_m=(1.0, 1.1, 4.9), chi2=0.3)
        memory.remember("mount", "rtcm-7", np.asarray(base_ecef_m()), time_ns=NOW_NS, offset=right)
        return memory_as_text(memory.bases)
    if name == "release":
        return AcceptedRelease(region="nagoya", map_version=9, manifest_sha256="0" * 64).model_dump_json()
    given = GivenPose(
        latitude_deg=35.1, longitude_deg=136.9, yaw_deg=12.0, horizontal_sigma_m=0.3, yaw_sigma_deg=2.0
    )
    return given.model_dump_json()


PARSERS: dict[str, Callable[[str], Any]] = {
    "correction": lambda text: from_text(text, LearningRules()),
    "differences": lambda text: references_from_text(text, VEHICLE),
    "bases": memory_from_text,
    "given_pose": GivenPose.model_validate_json,
    "release": AcceptedRelease.model_validate_json,
}


def assert_rejected(folder: Path, name: str, data: bytes, **vehicle: str) -> str:
    """The file is not used, is kept under another name, and is named in one issue; returns that line's reason."""
    path, bus = folder / f"{name}.json", FakeBus()
    path.write_bytes(data)
    file = state_file(folder, name, bus=bus, **vehicle)
    assert file.load(PARSERS[name]) is None
    assert file.was_rejected
    assert not path.exists()
    assert path.with_name(f"{name}.json.corrupt").read_bytes() == data
    ((code, text),) = bus.issues
    assert code == "state_rejected"
    assert text.startswith(f"{path}: ")
    assert text.endswith(f"; renamed to {name}.json.corrupt")
    assert "\n" not in text
    return text


@pytest.mark.parametrize("name", NAMES)
def test_a_whole_file_is_read_back(name: str, tmp_path: Path) -> None:
    write_state(tmp_path, name, _content(name))
    assert content_of(tmp_path, name) == _content(name)
    bus = FakeBus()
    assert state_file(tmp_path, name, bus=bus).load(PARSERS[name]) is not None
    assert bus.issues == []


@pytest.mark.parametrize("name", NAMES)
def test_any_changed_byte_rejects_a_file(name: str, tmp_path: Path) -> None:
    data = write_state(tmp_path, name, _content(name)).read_bytes()
    print("seed 24")
    rng = random.Random(24)
    for _ in range(200):
        at = rng.randrange(len(data))
        changed = bytes([data[at] ^ rng.randrange(1, 256)])
        assert_rejected(tmp_path, name, data[:at] + changed + data[at + 1 :])


@pytest.mark.parametrize("name", NAMES)
def test_a_file_that_is_cut_off_or_continued_is_rejected(name: str, tmp_path: Path) -> None:
    data = write_state(tmp_path, name, _content(name)).read_bytes()
    print("seed 25")
    rng = random.Random(25)
    for length in (0, len(data) - 1, *(rng.randrange(len(data)) for _ in range(40))):
        assert_rejected(tmp_path, name, data[:length])
    assert_rejected(tmp_path, name, data + b"\n")
    assert_rejected(tmp_path, name, data + data)


@pytest.mark.parametrize("name", NAMES)
def test_a_file_of_another_vehicle_is_rejected(name: str, tmp_path: Path) -> None:
    data = write_state(tmp_path, name, _content(name), vehicle="car-2").read_bytes()
    text = assert_rejected(tmp_path, name, data, vehicle="car-1")
    assert "vehicle: expected car-1, got car-2" in text


def test_a_file_in_the_place_of_another_one_is_rejected(tmp_path: Path) -> None:
    data = write_state(tmp_path, "bases", _content("bases")).read_bytes()
    assert "name: expected correction, got bases" in assert_rejected(tmp_path, "correction", data)


@pytest.mark.parametrize("name", NAMES)
def test_a_file_of_before_there_were_checksums_is_rejected(name: str, tmp_path: Path) -> None:
    assert "expected a state file of format 2" in assert_rejected(tmp_path, name, _content(name).encode())


def test_a_file_of_a_later_format_is_rejected(tmp_path: Path) -> None:
    data = write_state(tmp_path, "bases", _content("bases")).read_bytes()
    later = data.split(b'", ', 1)[1].replace(b'"format": 2', b'"format": 3')[:-2]
    digest = hashlib.sha256(later).hexdigest().encode()
    text = assert_rejected(tmp_path, "bases", b'{"sha256": "' + digest + b'", ' + later + b"}\n")
    assert "format: expected 2, got 3" in text


@pytest.mark.parametrize(
    ("name", "old", "new", "field"),
    [
        ("correction", '"correction_m":0.05', '"correction_m":0.35', "correction_m"),
        ("correction", '"sigma_m":0.02', '"sigma_m":1.02', "parts.0.sigma_m"),
        ("differences", '"mean_m":0.02', '"mean_m":20.0', "pairs.0.mean_m"),
        ("bases", '"sigma_m":[1.0', '"sigma_m":[0.0', "bases.0.days.0.sigma_m"),
        ("given_pose", '"latitude_deg":35.1', '"latitude_deg":95.1', "latitude_deg"),
        ("given_pose", "{", "[", "content"),
        ("release", '"map_version":9', '"map_version":-9', "map_version"),
    ],
)
def test_values_out_of_their_bounds_are_rejected_though_the_checksum_is_right(
    name: str, old: str, new: str, field: str, tmp_path: Path
) -> None:
    content = _content(name)
    assert old in content
    data = write_state(tmp_path, name, content.replace(old, new, 1)).read_bytes()
    assert f"{name}.json: {field}" in assert_rejected(tmp_path, name, data)


def test_a_pipe_in_the_place_of_a_file_is_rejected_and_does_not_block(tmp_path: Path) -> None:
    bus = FakeBus()
    os.mkfifo(tmp_path / "bases.json")
    assert state_file(tmp_path, "bases", bus=bus).load(memory_from_text) is None
    assert bus.text("state_rejected").endswith("bases.json: not a plain file; renamed to bases.json.corrupt")
    assert (tmp_path / "bases.json.corrupt").is_fifo()


def test_a_file_without_an_end_is_not_read_to_it(tmp_path: Path) -> None:
    bus = FakeBus()
    with (tmp_path / "bases.json").open("wb") as file:
        file.truncate(1 << 40)
    assert state_file(tmp_path, "bases", bus=bus).load(memory_from_text) is None
    assert "larger than" in bus.text("state_rejected")


def test_what_cannot_be_renamed_is_not_used(tmp_path: Path) -> None:
    (tmp_path / "bases.json").write_bytes(b"damaged")
    (tmp_path / "bases.json.corrupt" / "folder").mkdir(parents=True)
    bus = FakeBus()
    assert state_file(tmp_path, "bases", bus=bus).load(memory_from_text) is None
    assert "cannot be renamed: " in bus.text("state_rejected")
