"""Drives with an inertial unit, with wheels and without, through the services."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camber.simulator.scenario import load_scenario
from camber.tools.simulate import simulate
from support.running import in_one_process


@pytest.mark.parametrize("motion", [True, False])
def test_an_inertial_unit_drives_the_pose_and_right_fixes_are_confirmed(tmp_path: Path, motion: bool) -> None:
    """Without wheels and LiDAR nothing knows the speed between confirmed fixes: fewer are confirmed, none wrongly."""
    options = ["duration_s=30.0", "imu.class=mems", "imu.rate_hz=100", f"motion={str(motion).lower()}"]
    manifest = simulate(load_scenario("open-sky", options), tmp_path / "drive", quiet=True)
    drive = in_one_process(manifest, tmp_path / "out")
    poses = drive.recorded["pose"]
    step_s = np.diff([item.message.time_ns for item in poses]) * 1e-9
    assert np.median(step_s) == pytest.approx(0.02, abs=0.001)
    summary = drive.summary
    assert summary["confirmed"]["wrong"] == 0
    assert summary["right"]["kept"] > (0.9 if motion else 0.5)
    speeds = [item.message.speed_m_s for item in poses[len(poses) // 2 :]]
    assert all((speed is not None) == motion for speed in speeds)
