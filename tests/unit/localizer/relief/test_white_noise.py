"""White noise of heights by the differences of neighbours: beside slow errors, errors of the map and wrong fixes."""

from __future__ import annotations

import numpy as np
import pytest

from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief.white_noise import WhiteNoise, white_sigma_m

MODEL = HeightErrorModel()
CLAIMED_M = 0.03
STEP_M = 5.0


def drive(seed: int, white_m: float, *, slow_m: float = 0.0, wrong: bool = False) -> np.ndarray:
    """Residuals of 200 heights every five metres; slow errors last 30 heights."""
    rng = np.random.default_rng(seed)
    print(f"seed {seed}")
    slow = np.zeros(200)
    keep = np.exp(-1.0 / 30.0)
    for k in range(1, 200):
        slow[k] = keep * slow[k - 1] + slow_m * np.sqrt(1.0 - keep**2) * rng.standard_normal()
    residual: np.ndarray = slow + white_m * rng.standard_normal(200)
    if wrong:
        residual[::12] += 3.0
    return residual


def measured(residual: np.ndarray, map_sigma_m: float = 0.0) -> float:
    noise = WhiteNoise(MODEL)
    for k, each in enumerate(residual.tolist()):
        noise.add(each, (STEP_M * k, 0.0), map_sigma_m)
    return noise.sigma_m(CLAIMED_M)


@pytest.mark.parametrize("white_m", [0.005, 0.01, 0.02])
def test_slow_errors_and_wrong_fixes_do_not_change_it(white_m: float) -> None:
    for seed in range(4):
        assert measured(drive(seed, white_m, slow_m=2.0 * white_m)) == pytest.approx(white_m, rel=0.45)
        assert measured(drive(seed, white_m, wrong=True)) == pytest.approx(white_m, rel=0.45)


def test_it_is_at_most_what_is_claimed_and_that_as_long_as_few_heights_are_known() -> None:
    residual = drive(0, 0.2)
    assert measured(residual) == CLAIMED_M
    assert measured(drive(0, 0.005)[:19]) == CLAIMED_M
    assert measured(drive(0, 0.005)[:20]) < CLAIMED_M


def test_after_a_jump_of_the_position_it_is_measured_anew() -> None:
    noise = WhiteNoise(MODEL)
    for each in drive(0, 0.005).tolist():
        noise.add(each, (0.0, 0.0), 0.0)
    assert noise.sigma_m(CLAIMED_M) < CLAIMED_M
    noise.forget()
    assert noise.sigma_m(CLAIMED_M) == CLAIMED_M


def test_what_the_maps_errors_change_is_no_noise_of_the_fixes() -> None:
    rng = np.random.default_rng(1)
    places = np.column_stack((STEP_M * np.arange(400), np.zeros(400)))
    map_m = np.full(400, 0.05)
    errors = MODEL.map_errors.covariance_m2(places, map_m)
    residual = np.linalg.cholesky(errors + 1e-12 * np.eye(400)) @ rng.standard_normal(400)
    residual += 0.01 * rng.standard_normal(400)
    assert white_sigma_m(residual, places, map_m, MODEL) == pytest.approx(0.01, rel=0.3)


def test_without_neighbours_on_the_map_nothing_is_measured() -> None:
    residual = np.array([0.0, np.nan, 0.1, np.nan])
    assert white_sigma_m(residual, np.zeros((4, 2)), np.zeros(4), MODEL) is None
