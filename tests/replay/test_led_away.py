"""Fixes that are led away, and a base that is off, on a hilly road without LiDAR: no usable position beyond its level.

A short version of `camber common_faults`: minutes of driving instead of ten, with one seed.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from camber.validation.common_faults.drive import Setting
from camber.validation.common_faults.fault_cases import BY_NAME
from camber.validation.common_faults.run import outcome_of

SEED = 3
LASTS_S, ONSET_S = 170.0, 90.0
CASES = ("along-0.05", "across-0.05", "along-0.3", "base-1.7")


@pytest.mark.parametrize("name", CASES)
def test_no_usable_position_is_beyond_its_level(name: str, tmp_path: Path) -> None:
    fault = BY_NAME[name]
    fault = replace(fault, onset_s=min(fault.onset_s, ONSET_S))
    setting = Setting(ground="hilly", seed=SEED, lasts_s=LASTS_S)
    figures = outcome_of(setting, fault, "required", tmp_path)
    print(f"seed {SEED}: {figures}")
    assert figures["wrong"] > 100
    assert figures["beyond_level"] == 0
    assert figures["beyond_vertical_level"] == 0
