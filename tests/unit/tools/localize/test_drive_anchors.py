"""Fixes and anchors of a drive, for a localizer that is run alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from camber.formats.drive.truth_csv import FIX_STATES
from camber.replay.drive_inputs import DriveInputs, prepare_drive
from camber.schemas.drive import ManifestError, load_manifest
from camber.tools.localize.drive_anchors import anchors_of, receiver_fixes


@pytest.fixture(scope="module")
def inputs(blind: Path, tmp_path_factory: pytest.TempPathFactory) -> DriveInputs:
    return prepare_drive(load_manifest(blind), tmp_path_factory.mktemp("work"))


def test_the_receivers_fixes_come_in_the_order_of_time_each_once(inputs: DriveInputs) -> None:
    fixes = receiver_fixes(inputs)
    times = [fix.time_ns for fix in fixes]
    assert times == sorted(set(times))
    assert inputs.truth is not None
    states = inputs.truth.fix_state
    assert states is not None
    fixed = {fix.time_ns for fix in fixes if fix.quality == "fixed"}
    assert fixed == set(inputs.truth.time_ns[states != FIX_STATES.index("none")].tolist())


def test_right_fixes_are_those_that_were_made_right(inputs: DriveInputs) -> None:
    assert inputs.truth is not None
    assert inputs.truth.fix_state is not None
    right = inputs.truth.time_ns[inputs.truth.fix_state == FIX_STATES.index("right")].tolist()
    anchors = anchors_of(inputs, "right-fixes")
    assert [verdict.time_ns for verdict in anchors] == right
    by_time = {fix.time_ns: fix for fix in receiver_fixes(inputs)}
    for verdict in anchors:
        fix = by_time[verdict.time_ns]
        assert verdict.verdict == "confirmed"
        assert (verdict.latitude_rad, verdict.longitude_rad) == (fix.latitude_rad, fix.longitude_rad)
        assert verdict.covariance_enu_m2 == fix.covariance_enu_m2


def test_the_truth_is_an_anchor_once_a_second(inputs: DriveInputs) -> None:
    assert inputs.truth is not None
    anchors = anchors_of(inputs, "truth")
    assert np.diff([verdict.time_ns for verdict in anchors]).tolist() == [10**9] * (len(anchors) - 1)
    assert len(anchors) == 121
    place = dict(zip(inputs.truth.time_ns.tolist(), inputs.truth.latitude_rad.tolist(), strict=True))
    assert all(verdict.latitude_rad == place[verdict.time_ns] for verdict in anchors)
    assert anchors_of(inputs, "none") == []


def test_without_truth_or_receiver_a_line_says_so(inputs: DriveInputs) -> None:
    blind = replace(inputs, truth=None)
    for kind in ("truth", "right-fixes"):
        with pytest.raises(ManifestError, match=f"no table truth, expected one for anchors of {kind}"):
            anchors_of(blind, kind)  # type: ignore[arg-type]
    deaf = replace(inputs, manifest=inputs.manifest.model_copy(update={"receiver": None}))
    with pytest.raises(ManifestError, match="no table receiver, expected the receiver's own positions"):
        receiver_fixes(deaf)
