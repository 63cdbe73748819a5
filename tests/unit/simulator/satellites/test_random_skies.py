"""Skies at random, and the wrong fixes that they have."""

from __future__ import annotations

import numpy as np
import pytest

from camber.simulator.satellites.random_skies import LATER_S, RandomSkies, random_skies
from camber.simulator.satellites.wrong_fix_shapes import FixShapes, Kind, fix_shapes

SEED = 5


@pytest.fixture(scope="module")
def skies() -> RandomSkies:
    return random_skies(150, np.random.default_rng(SEED))


@pytest.fixture(scope="module")
def wrong(skies: RandomSkies) -> FixShapes:
    return fix_shapes(skies, "cycles", 4, np.random.default_rng(SEED))


def test_directions_come_from_above_and_turn_slowly(skies: RandomSkies) -> None:
    for k in range(len(skies.rows)):
        m = skies.rows[k]
        line = -skies.direction[k, :m]
        assert np.linalg.norm(line, axis=1) == pytest.approx(1.0)
        assert (line[:, 2] >= np.sin(np.deg2rad(9.99))).all()
        turned = np.linalg.norm(skies.later_direction[k, :m] - skies.direction[k, :m], axis=1)
        assert (turned / LATER_S < 3e-4).all()
        assert len(set(skies.satellite[k, :m])) >= 5


def test_streets_hide_satellites_and_their_signals_are_worse(skies: RandomSkies) -> None:
    assert 0.4 < skies.street.mean() < 0.9
    assert skies.rows[skies.street].mean() < skies.rows[~skies.street].mean()
    assert skies.reflection_m[skies.street].max() > skies.reflection_m[~skies.street].max()


def test_wrong_integers_move_the_position_as_least_squares_says(skies: RandomSkies) -> None:
    """One band and equal variances: the shift follows from centred directions alone."""
    equal = random_skies(60, np.random.default_rng(SEED + 1))
    equal.phase_sigma_m[:] = 0.003
    shapes = fix_shapes(equal, "right", 1, np.random.default_rng(SEED))
    assert len(shapes.sky) > 20
    for k, sky in enumerate(shapes.sky.tolist()):
        m = equal.rows[sky]
        g = equal.direction[sky, :m].copy()
        for group in np.unique(equal.group[sky, :m]):
            inside = equal.group[sky, :m] == group
            g[inside] -= g[inside].mean(axis=0)
        assert shapes.claimed_m2[k] == pytest.approx(np.linalg.inv(g.T @ g) * 0.003**2, rel=1e-6)
        assert shapes.shift_m[k] == pytest.approx([0.0, 0.0, 0.0])


def test_integers_off_by_cycles_shift_by_decimetres_and_residuals_see_most_of_them(wrong: FixShapes) -> None:
    size = np.linalg.norm(wrong.shift_m, axis=1)
    # A group that is off as a whole moves nothing: its clock takes that in.
    assert (size > 0.0).mean() > 0.95
    assert 0.05 < np.median(size) < 1.0
    assert wrong.residuals_agree.mean() < 0.2
    assert (np.abs(wrong.rate_m_s).max(axis=1) < 0.05 * np.maximum(size, 0.2)).mean() > 0.9


@pytest.mark.parametrize("kind", ["cycles", "search", "right"])
def test_the_same_seed_makes_the_same_fixes(skies: RandomSkies, kind: Kind) -> None:
    one, again = (fix_shapes(skies, kind, 3, np.random.default_rng(SEED)) for _ in range(2))
    assert np.array_equal(one.shift_m, again.shift_m)
    other = fix_shapes(skies, kind, 3, np.random.default_rng(SEED + 1))
    assert not np.array_equal(one.sky, other.sky) or not np.array_equal(one.shift_m, other.shift_m)


def test_a_search_in_biased_floats_errs_by_metres_and_its_residuals_pass(skies: RandomSkies) -> None:
    made = fix_shapes(skies, "search", 20, np.random.default_rng(SEED))
    assert len(made.sky) >= 10
    assert np.median(np.linalg.norm(made.shift_m, axis=1)) > 0.5
    assert made.residuals_agree.mean() > 0.5
    assert np.bincount(made.sky).max() <= 3
