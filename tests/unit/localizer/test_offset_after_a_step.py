"""The offset of the fixes' track after a step of the fixes: the one before, moved by it."""

from __future__ import annotations

import pytest

from camber.localizer.fix_track import FixTrack
from camber.localizer.relief.fix_step_detection import FixStep
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.schemas.pose import FixesOffset

S = 1_000_000_000
T0 = 1_400_000_000 * S
OFFSET = FixesOffset(
    begin_time_ns=T0 + 100 * S,
    end_time_ns=T0 + 190 * S,
    east_north_m=(-1.2, 1.0),
    covariance_east_north=(0.04, 0.01, 0.09),
    growth_east_north_m_s=(0.001, 0.002),
    growth_covariance_east_north=(1e-6, 0.0, 2e-6),
)


@pytest.fixture
def fix_track() -> FixTrack:
    track = FixTrack(HeightErrorModel(), antenna_z_m=1.8)
    track.offset = OFFSET
    return track


def test_steps_add_to_the_offset_and_to_its_covariance(fix_track: FixTrack) -> None:
    fix_track.on_step(FixStep((1.1, -0.8), 0.01), T0 + 200 * S)
    fix_track.on_step(FixStep((0.4, 0.0), 0.02), T0 + 210 * S)
    after = fix_track.offset
    assert after is not None
    assert (after.begin_time_ns, after.end_time_ns, after.steps) == (T0 + 100 * S, T0 + 210 * S, 2)
    assert after.east_north_m == pytest.approx((0.3, 0.2))
    assert after.covariance_east_north == pytest.approx((0.07, 0.01, 0.12))
    assert after.growth_east_north_m_s == OFFSET.growth_east_north_m_s


def test_after_a_step_of_another_base_nothing_is_known(fix_track: FixTrack) -> None:
    fix_track.on_step(FixStep(None), T0 + 200 * S)
    assert fix_track.offset is None
    fix_track.on_step(FixStep((1.0, 0.0), 0.01), T0 + 210 * S)
    assert fix_track.offset is None
