"""The model of height errors beside a recorded drive."""

from __future__ import annotations

import pytest

from camber.localizer.relief.height_errors import HeightErrorModel
from support.height_claims import shares
from support.wrong_fix_shapes import nagoya_fixes


def test_slow_errors_are_as_many_times_the_claim_as_on_a_recorded_drive() -> None:
    fixes = nagoya_fixes()
    if fixes is None:
        pytest.skip("CAMBER_DATA is not set")
    measured = [share for count, _, share in shares(fixes) if count > 30]
    assert len(measured) == 3
    assert min(measured) <= HeightErrorModel().fix_common_share <= max(measured)


def test_slow_errors_are_never_less_than_those_of_the_phase() -> None:
    model = HeightErrorModel()
    assert model.fix_common_m(0.001) == model.fix_common_sigma_m
    assert model.fix_common_m(0.05) == pytest.approx(model.fix_common_share * 0.05)
