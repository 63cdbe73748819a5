"""The engine beside rnx2rtkp in a few simulated streets; `support.engine_statistics` runs many."""

import functools

import pytest

from support.engine_statistics import Comparison, compare
from support.rtklib_runs import RNX2RTKP

pytestmark = pytest.mark.skipif(RNX2RTKP is None, reason="rnx2rtkp is not installed (Debian: rtklib)")


@functools.cache
def canyons() -> Comparison:
    return compare(range(1, 7), duration_s=60.0)


def test_in_streets_more_fixes_are_right_and_fewer_are_wrong_than_rnx2rtkps_at_the_same_ratio():
    comparison = canyons()
    assert comparison.epochs == 360
    for ours in (comparison.alone, comparison.aided):
        assert ours.right > comparison.rtklib.right > 50
        assert ours.wrong * (comparison.rtklib.right + comparison.rtklib.wrong) <= comparison.rtklib.wrong * (
            ours.right + ours.wrong
        )


def test_the_doppler_prior_adds_right_fixes():
    comparison = canyons()
    assert comparison.aided.right > 1.05 * comparison.alone.right
    assert comparison.aided.wrong <= comparison.alone.wrong + 1


def test_other_estimates_that_agree_add_right_fixes():
    comparison = canyons()
    assert comparison.alone_trials.right >= 0.1 * comparison.alone.right
    assert comparison.alone_trials.wrong + comparison.aided_trials.wrong <= 2


def test_without_houses_nearly_every_epoch_is_fixed_to_two_centimetres():
    comparison = compare(range(1, 3), duration_s=60.0, open_sky=True)
    for ours in (comparison.alone, comparison.aided):
        figures = ours.figures(comparison.epochs)
        assert figures["fixed_share"] >= 0.99
        assert figures["right_horizontal_p95_m"] <= 0.02
        assert ours.wrong == 0
