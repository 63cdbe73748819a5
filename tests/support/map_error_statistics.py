"""Height difference of two drives of one road a month apart, and models of its covariance.

`PYTHONPATH=tests python -m support.map_error_statistics` prints docs/theory/map-errors.md's tables in a minute (with
CAMBER_DATA).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from camber.road_map.map_error_model import MAP_ERRORS, MapErrorModel

Floats = NDArray[np.float64]

DAYS = ("2021-08-05", "2021-09-02")
SPACING_M = 10.0
LAGS_M = (10, 20, 50, 100, 150, 200, 300, 500)
NEAR_M = 0.5
"""Beyond it the crossfall of the road is in the difference."""
_OTHER_SPACING_M = 0.25
_PARALLEL = 0.9
_NUGGET_M2 = 1e-8
Correlation = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RoadDifference:
    """The later height less the earlier one (n,) [m], at distances (n,) [m] along the earlier track."""

    distance_m: Floats
    difference_m: Floats


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Fitted:
    """Log-likelihood, σ of each part, correlation lengths, mean and its σ, of one model."""

    name: str
    log_likelihood: float
    sigma_m: tuple[float, ...]
    length_m: tuple[float, ...]
    mean_m: float
    mean_sigma_m: float


def road_difference(folder: Path, spacing_m: float = SPACING_M) -> RoadDifference:
    """Where the two tracks of `boreas-tracks` are within half a metre of one another and point the same way."""
    earlier, later = (
        _track(folder / f"{day}.csv", step)
        for day, step in zip(DAYS, (spacing_m, _OTHER_SPACING_M), strict=True)
    )
    apart_m, nearest = cKDTree(later[:, 1:3]).query(earlier[:, 1:3])
    ahead = [np.gradient(track[:, 1:3], axis=0) for track in (earlier, later)]
    ahead = [vector / np.linalg.norm(vector, axis=1)[:, None] for vector in ahead]
    same = (apart_m < NEAR_M) & (np.sum(ahead[0] * ahead[1][nearest], axis=1) > _PARALLEL)
    return RoadDifference(distance_m=earlier[same, 0], difference_m=(later[nearest, 3] - earlier[:, 3])[same])


def sample_correlation(road: RoadDifference, lag_m: float) -> float:
    """Mean product of differences that lie `lag_m` apart, over the variance."""
    z = road.difference_m - road.difference_m.mean()
    gap_m = np.abs(road.distance_m[:, None] - road.distance_m[None, :])
    first, second = np.nonzero(np.abs(gap_m - lag_m) < 0.5)
    return float(np.mean(z[first] * z[second]) / z.var())


def exponential(distance_m: Floats, length_m: Floats) -> Floats:
    """First-order Gauss–Markov."""
    return np.asarray(np.exp(-distance_m / length_m))


def second_order(distance_m: Floats, length_m: Floats) -> Floats:
    """Second-order Gauss–Markov."""
    return np.asarray((1.0 + distance_m / length_m) * np.exp(-distance_m / length_m))


MODELS: dict[str, tuple[tuple[Correlation, ...], tuple[float, ...]]] = {
    "exponential": ((exponential,), (100.0,)),
    "second-order": ((second_order,), (60.0,)),
    "two exponentials": ((exponential, exponential), (10.0, 200.0)),
    "exponential and second-order": ((exponential, second_order), (30.0, 80.0)),
    "two second-order": ((second_order, second_order), (8.0, 80.0)),
}


def fit(road: RoadDifference, name: str, lengths_m: tuple[float, ...] | None = None) -> Fitted:
    """Maximum likelihood over σ and length of each part, or over σ alone with the lengths given; the mean is free."""
    parts, begin_m = MODELS[name]
    gap_m = np.abs(road.distance_m[:, None] - road.distance_m[None, :])
    k = len(parts)

    def covariance(parameters: Floats) -> Floats:
        lengths = np.exp(parameters[k:]) if lengths_m is None else lengths_m
        sigma2 = np.exp(parameters[:k])
        terms = [v * part(gap_m, m) for v, part, m in zip(sigma2, parts, lengths, strict=True)]
        return np.asarray(sum(terms) + _NUGGET_M2 * np.eye(len(gap_m)))

    variance = road.difference_m.var()
    begin = np.log([0.1 * variance] * (k - 1) + [variance] + (list(begin_m) if lengths_m is None else []))
    best = minimize(
        lambda p: -log_likelihood(road, covariance(p))[0], begin, method="Nelder-Mead",
        options={"maxiter": 400, "xatol": 0.01, "fatol": 0.01},
    )  # fmt: skip
    value, mean_m, mean_sigma_m = log_likelihood(road, covariance(best.x))
    lengths = tuple(np.exp(best.x[k:])) if lengths_m is None else lengths_m
    return Fitted(
        name=name, log_likelihood=value, sigma_m=tuple(np.exp(0.5 * best.x[:k])), length_m=lengths,
        mean_m=mean_m, mean_sigma_m=mean_sigma_m,
    )  # fmt: skip


def log_likelihood(road: RoadDifference, covariance_m2: Floats) -> tuple[float, float, float]:
    """Of normal differences with this covariance and a free mean, without the constant; mean, and its σ."""
    factor = cho_factor(covariance_m2, lower=True)
    weights = cho_solve(factor, np.ones(len(covariance_m2)))
    mean_m = float(weights @ road.difference_m / weights.sum())
    left_m = road.difference_m - mean_m
    value = -np.log(np.diag(factor[0])).sum() - 0.5 * left_m @ cho_solve(factor, left_m)
    return float(value), mean_m, float(weights.sum() ** -0.5)


def likelihood_of(road: RoadDifference, model: MapErrorModel) -> float:
    """The log-likelihood of a model at the σ that suits it best, which has a closed form."""
    n = len(road.distance_m)
    correlation = model.covariance_m2(road.distance_m[:, None], np.ones(n)) + 1e-5 * np.eye(n)
    factor = cho_factor(correlation, lower=True)
    weights = cho_solve(factor, np.ones(n))
    left_m = road.difference_m - weights @ road.difference_m / weights.sum()
    sigma2 = float(left_m @ cho_solve(factor, left_m)) / n
    return float(-np.log(np.diag(factor[0])).sum() - 0.5 * n * (np.log(sigma2) + 1.0))


def _track(path: Path, spacing_m: float) -> Floats:
    """Distance driven, easting, northing, altitude (n, 4), every `spacing_m`."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    rows = np.column_stack((table["easting"], table["northing"], table["altitude"]))
    step_m = np.hypot(*np.diff(rows[:, :2], axis=0).T)
    moving = np.concatenate(([True], step_m > 0.02))
    rows = rows[moving]
    driven_m = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(rows[:, :2], axis=0).T))))
    at_m = np.arange(0.0, driven_m[-1], spacing_m)
    return np.column_stack((at_m, *(np.interp(at_m, driven_m, rows[:, k]) for k in range(3))))


def main() -> None:
    """Print the tables."""
    road = road_difference(Path(os.environ["CAMBER_DATA"]) / "boreas-tracks")
    print(
        f"{len(road.distance_m)} places every {SPACING_M:g} m, mean {road.difference_m.mean():+.3f} m, "
        f"σ {road.difference_m.std():.4f} m"
    )
    print("| distance | measured | model | exp(−d / 20 m) |\n|---|---|---|---|")
    for lag_m in LAGS_M:
        model = float(MAP_ERRORS.correlation(lag_m))
        print(
            f"| {lag_m} m | {sample_correlation(road, lag_m):.2f} | {model:.2f} | {np.exp(-lag_m / 20.0):.2f} |"
        )
    print("| model | log-likelihood | σ | lengths | mean |\n|---|---|---|---|---|")
    for name in MODELS:
        _print(fit(road, name))
    _print(fit(road, "exponential", (20.0,)))
    for length_m in (60.0, 75.0, 90.0, 100.0, 110.0, 120.0):
        _print(fit(road, "exponential and second-order", (40.0, length_m)))


def _print(fitted: Fitted) -> None:
    sigma = ", ".join(f"{value * 1e3:.1f}" for value in fitted.sigma_m)
    lengths = ", ".join(f"{value:.0f}" for value in fitted.length_m)
    mean = f"{fitted.mean_m:+.3f} ± {fitted.mean_sigma_m:.3f} m"
    print(f"| {fitted.name} | {fitted.log_likelihood:.1f} | {sigma} mm | {lengths} m | {mean} |")


if __name__ == "__main__":
    main()
