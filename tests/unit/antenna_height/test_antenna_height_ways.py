"""The height by stroke is H (1); two ways that contradict one another are told."""

from __future__ import annotations

import pytest

from camber.antenna_height.ways import disagree, fixed_height, stroke_height
from camber.schemas.motion import Suspension

TIME_NS = 1_300_000_000 * 1_000_000_000


def test_stroke_height_is_the_sum_of_h_1() -> None:
    suspension = Suspension(time_ns=TIME_NS, stroke_height_m=0.45, stroke_sigma_m=0.03)
    way = stroke_height(suspension, suspension_to_antenna_m=0.92, tyre_radius_m=0.31, stored_sigma_m=0.04)
    assert way.way == "stroke"
    assert way.height_m == pytest.approx(0.92 + 0.45 + 0.31)
    assert way.sigma_m == pytest.approx(0.05)


def test_a_fixed_height_is_as_it_was_measured() -> None:
    way = fixed_height(1.8, 0.02)
    assert (way.way, way.height_m, way.sigma_m) == ("fixed", 1.8, 0.02)


@pytest.mark.parametrize(
    ("gap_m", "contradict"), [(0.0, False), (0.199, False), (0.201, True), (-0.201, True)]
)
def test_heights_contradict_beyond_four_sigmas_of_their_difference(gap_m: float, contradict: bool) -> None:
    a, b = fixed_height(1.8, 0.03), fixed_height(1.8 + gap_m, 0.04)
    assert disagree(a, b) is contradict
    assert disagree(b, a) is contradict


def test_heights_without_any_error_must_be_equal() -> None:
    assert not disagree(fixed_height(1.8, 0.0), fixed_height(1.8, 0.0))
    assert disagree(fixed_height(1.8, 0.0), fixed_height(1.8001, 0.0))
