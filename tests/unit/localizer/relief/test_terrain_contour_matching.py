"""Shift of a track by heights: against dense least squares, on made-up hills, on flat ground, with wrong fixes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief.terrain import TerrainHeights
from camber.localizer.relief.terrain_contour_matching import HeightWindow, estimate_shift, prior_share
from camber.localizer.relief.track_errors import track_error_modes
from support.made_up_relief import drive, flat, hills

Floats = NDArray[np.float64]
MODEL = HeightErrorModel()
PRIOR = np.diag([400.0, 400.0])
INSIDE_99 = 9.21  # chi-square, 2 degrees of freedom


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_least_squares_solution(seed: int) -> None:
    """The oracle minimises the same sum over all parameters and errors without any of the estimator's algebra."""
    field = hills(seed)
    window = drive(field, MODEL, shift_m=(3.0, -2.0), seed=seed)
    estimate = estimate_shift(window, field.at, MODEL, prior=PRIOR)
    assert estimate is not None
    places = np.column_stack([window.east_m, window.north_m])
    errors = MODEL.covariance(
        places, window.time_s, map_sigma_m=window.map_sigma_m, fix_sigma_m=window.sigma_m
    )
    lower = np.linalg.cholesky(errors)

    def residuals(theta: Floats) -> Floats:
        road = field.at(window.east_m + theta[0], window.north_m + theta[1]).elevation_m + theta[2]
        whitened = np.linalg.solve(lower, window.height_m - road)
        return np.concatenate([whitened, theta[:2] / 20.0, theta[2:] / MODEL.offset_sigma_m])

    oracle = least_squares(residuals, np.array([3.0, -2.0, 1.8]), xtol=1e-12, ftol=1e-12)
    covariance = np.linalg.inv(oracle.jac.T @ oracle.jac)[:2, :2]
    assert estimate.rejected == 0
    np.testing.assert_allclose(estimate.shift, oracle.x[:2], atol=2e-3)
    scale = max(1.0, estimate.chi2 / estimate.count)
    np.testing.assert_allclose(estimate.covariance, scale * covariance, rtol=1e-2, atol=1e-5)


def test_its_ellipse_holds_the_truth() -> None:
    inside, shares = [], []
    for seed in range(120):
        field = hills(seed)
        rng = np.random.default_rng(1000 + seed)
        shift = rng.normal(0.0, 8.0, 2)
        window = drive(field, MODEL, shift_m=(float(shift[0]), float(shift[1])), seed=seed)
        estimate = estimate_shift(window, field.at, MODEL, prior=PRIOR)
        assert estimate is not None
        if estimate.unique:
            error = estimate.shift - shift
            inside.append(error @ np.linalg.solve(estimate.covariance, error) < INSIDE_99)
            shares.append(estimate.prior_share)
    print(f"seeds 0 to 119: {np.mean(inside):.3f} of {len(inside)} in the 99 % ellipse")
    assert len(inside) > 100
    assert np.mean(inside) > 0.95
    assert np.median(shares) < 0.01


@pytest.mark.parametrize("grade", [(0.0, 0.0), (0.03, 0.01)])
def test_a_plane_determines_nothing(grade: tuple[float, float]) -> None:
    """Flat, or rising evenly: the offset of the heights absorbs every shift."""
    field = flat(grade)
    window = drive(field, MODEL, shift_m=(5.0, 5.0), seed=1)
    estimate = estimate_shift(window, field.at, MODEL, prior=PRIOR)
    assert estimate is not None
    assert estimate.prior_share > 0.97
    assert np.linalg.eigvalsh(estimate.covariance)[0] > 0.97 * 400.0


def test_a_straight_road_determines_along_only() -> None:
    field = hills(3)
    window = drive(field, MODEL, shift_m=(2.0, 0.0), seed=3)
    along = window._replace(east_m=np.arange(len(window.time_s)) * 10.0, north_m=np.zeros(len(window.time_s)))

    def level_across(east_m: Floats, north_m: Floats):  # type: ignore[no-untyped-def]
        road = field.at(east_m, np.zeros_like(north_m + east_m))
        return road._replace(slope_north=np.zeros_like(road.slope_north))

    height = level_across(along.east_m + 2.0, along.north_m).elevation_m + 1.8
    estimate = estimate_shift(along._replace(height_m=height), level_across, MODEL, prior=PRIOR)
    assert estimate is not None
    assert estimate.shift[0] == pytest.approx(2.0, abs=0.2)
    assert estimate.covariance[0, 0] < 1.0
    assert estimate.covariance[1, 1] == pytest.approx(400.0)
    assert estimate.prior_share == pytest.approx(1.0)


@pytest.mark.parametrize("off_m", [0.6, -5.0, 30.0])
def test_an_episode_of_wrong_heights_is_rejected(off_m: float) -> None:
    field = hills(5)
    window = drive(field, MODEL, shift_m=(3.0, -2.0), seed=5)
    right = estimate_shift(window, field.at, MODEL, prior=PRIOR)
    height = window.height_m.copy()
    height[40:48] += off_m
    estimate = estimate_shift(window._replace(height_m=height), field.at, MODEL, prior=PRIOR)
    assert right is not None
    assert estimate is not None
    assert estimate.rejected >= 8
    assert np.hypot(*(estimate.shift - right.shift)) < 0.5


def test_an_episode_of_15_cm_shifts_by_no_more_than_a_metre_or_so() -> None:
    """Its edges alone are seen, as the map's errors are as smooth as its inside."""
    field = hills(5)
    window = drive(field, MODEL, shift_m=(3.0, -2.0), seed=5)
    height = window.height_m.copy()
    height[40:48] += 0.15
    estimate = estimate_shift(window._replace(height_m=height), field.at, MODEL, prior=PRIOR)
    assert estimate is not None
    assert np.hypot(*(estimate.shift - [3.0, -2.0])) < 1.5


def test_a_vertical_drift_of_the_fixes_costs_little() -> None:
    """1 cm a minute is not the road's shape: b's random walk takes it."""
    field = hills(6)
    window = drive(field, MODEL, shift_m=(0.0, 0.0), seed=6)
    right = estimate_shift(window, field.at, MODEL, prior=PRIOR)
    drifted = estimate_shift(
        window._replace(height_m=window.height_m + window.time_s * 0.01 / 60.0), field.at, MODEL, prior=PRIOR
    )
    assert right is not None
    assert drifted is not None
    assert np.hypot(*(drifted.shift - right.shift)) < 0.5


def test_a_vertical_fault_in_the_shape_of_the_slope_fakes_a_shift() -> None:
    """What no height can show, so that a page must say it: heights of the road 4 m further along."""
    field = hills(7)
    window = drive(field, MODEL, shift_m=(0.0, 0.0), seed=7)
    here = field.at(window.east_m, window.north_m).elevation_m
    there = field.at(window.east_m + 4.0, window.north_m).elevation_m
    fooled = estimate_shift(
        window._replace(height_m=window.height_m + there - here), field.at, MODEL, prior=PRIOR
    )
    assert fooled is not None
    assert fooled.shift[0] == pytest.approx(4.0, abs=1.5)


def test_errors_of_the_track_are_estimated_with_the_shift() -> None:
    """A scale of 1 % and a heading of 1° over 1 km are 10 and 17 m; the place of the last height is still right."""
    field = hills(8)
    window = drive(field, MODEL, shift_m=(0.0, 0.0), seed=8)
    modes = track_error_modes(window.east_m, window.north_m, window.time_s)
    off = modes @ np.array([-0.0175, -0.01, 0.0])
    track = window._replace(east_m=window.east_m + off[:, 0], north_m=window.north_m + off[:, 1])
    prior = np.diag([400.0, 400.0, 0.035**2, 0.01**2, 1e-8])
    modes = track_error_modes(track.east_m, track.north_m, track.time_s)
    estimate = estimate_shift(track, field.at, MODEL, prior=prior, modes=modes)
    assert estimate is not None
    error = estimate.shift[:2]
    assert error @ np.linalg.solve(estimate.covariance[:2, :2], error) < INSIDE_99
    assert np.hypot(*error) < 3.0


def test_the_modes_are_the_derivatives_of_a_dead_reckoned_track() -> None:
    def dead_reckoned(yaw_rad: float, scale: float, bias_rad_s: float) -> Floats:
        time_s = np.arange(0.0, 50.0, 0.5)
        heading = 0.02 * time_s + yaw_rad + bias_rad_s * (time_s - time_s[-1])
        step = (1.0 + scale) * 5.0 * np.column_stack([np.cos(heading), np.sin(heading)])
        middle = 0.5 * (step[1:] + step[:-1])
        to_last = np.cumsum(middle[::-1], axis=0)[::-1]
        return -np.vstack([to_last, np.zeros(2)])

    nominal = dead_reckoned(0.0, 0.0, 0.0)
    modes = track_error_modes(nominal[:, 0], nominal[:, 1], np.arange(0.0, 50.0, 0.5))
    small = 1e-6
    for index in range(3):
        moved = [0.0, 0.0, 0.0]
        moved[index] = small
        derivative = (dead_reckoned(*moved) - nominal) / small
        np.testing.assert_allclose(modes[:, :, index], derivative, atol=2e-2 * np.abs(derivative).max())


def test_the_prior_share_bounds_what_a_wrong_prior_does() -> None:
    field = hills(9)
    window = drive(field, MODEL, shift_m=(0.0, 0.0), seed=9)
    right = estimate_shift(window, field.at, MODEL, prior=PRIOR)
    moved = window._replace(east_m=window.east_m - 12.0)
    off = estimate_shift(moved, field.at, MODEL, prior=PRIOR)
    assert right is not None
    assert off is not None
    assert abs(off.shift[0] - 12.0 - right.shift[0]) <= 12.0 * right.prior_share + 0.05
    assert prior_share(np.eye(2), 4.0 * np.eye(2)) == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("away_m", "known_from_m", "possible"), [(6.0, -1e3, True), (45.0, -1e3, False), (14.0, 700.0, False)]
)
def test_no_result_lies_in_the_tails_of_the_prior_or_where_the_map_ends(
    away_m: float, known_from_m: float, possible: bool
) -> None:
    """A bowl, with the prior σ 8 m: its heights say how far away they are, without a limit."""

    def bowl(east_m: Floats, north_m: Floats) -> TerrainHeights:
        elevation_m = np.where(east_m > known_from_m, 2e-4 * (east_m**2 + north_m**2), np.nan)
        return TerrainHeights(elevation_m, 4e-4 * east_m, 4e-4 * north_m)

    seconds = np.arange(80.0)
    window = HeightWindow(
        time_s=seconds,
        east_m=15.0 * seconds,
        north_m=200.0 * np.sin(seconds / 10.0),
        height_m=2e-4 * ((15.0 * seconds + away_m) ** 2 + (200.0 * np.sin(seconds / 10.0)) ** 2),
        sigma_m=np.full(80, 0.01),
        map_sigma_m=np.full(80, 0.03),
    )
    estimate = estimate_shift(window, bowl, MODEL, prior=64.0 * np.eye(2), starts=[np.zeros(2)])
    assert (estimate is not None) is possible
    if estimate is not None:
        np.testing.assert_allclose(estimate.shift, (away_m, 0.0), atol=0.5)
