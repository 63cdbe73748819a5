"""A drive in which the localizer gets no motion for some seconds again and again."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from camber.localizer.service import LocalizerService
from camber.replay.drive_inputs import prepare_drive
from camber.replay.single_process_replay import replay_in_one_process
from camber.schemas.drive import load_manifest
from support.live_drive import count_verdicts, known_fixes, write_drive

GAP_S, EVERY_S = 2.5, 17.0


@pytest.mark.parametrize("first_s", [3.0, 8.0, 13.0])
def test_no_gap_makes_a_right_fix_erroneous_or_lets_a_wrong_one_pass(tmp_path: Path, first_s: float) -> None:
    manifest = write_drive(tmp_path / "drive", seed=1)
    known, begin_ns = known_fixes(manifest), list[int]()
    take = LocalizerService._on_motion

    def with_gaps(service: LocalizerService, motion: Any) -> None:
        begin_ns[:] = begin_ns or [motion.time_ns]
        if (1e-9 * (motion.time_ns - begin_ns[0]) - first_s) % EVERY_S >= GAP_S:
            take(service, motion)

    with patch.object(LocalizerService, "_on_motion", with_gaps):
        inputs = prepare_drive(load_manifest(manifest), tmp_path / "work")
        output = replay_in_one_process(inputs, tmp_path, channels=("fix", "verdict"))
    fixes, verdicts = ([item.message for item in output.recorded[name]] for name in ("fix", "verdict"))
    counts = count_verdicts(known, fixes, verdicts)
    assert counts["right", "erroneous"] == 0, counts
    assert counts["wrong", "confirmed"] == counts["wrong", "confirmed_after_verification"] == 0, counts
    assert counts["right", "confirmed"] > 180, counts
