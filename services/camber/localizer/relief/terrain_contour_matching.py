"""Horizontal shift of a track from the heights over a window, by weighted least squares.

Terrain-aided navigation (Hostetler and Andreas 1983, Nonlinear Kalman filtering techniques for terrain-aided
navigation; as a batch: Golden 1980, Terrain contour matching). With the track's places x_i, modes of its error
B_i θ and the map's elevation m,

    h_i = m(x_i + B_i θ) + b + e_i,   e ~ N(0, C),   θ ~ N(0, P)

is solved by Gauss-Newton from the best shifts of a grid: a road that rises and falls has several minima, and those of
nearly the same cost make the result ambiguous. No horizontal part of a fix is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camber.localizer.arrays import Floats, Mask
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief.terrain import TerrainAt, TerrainHeights

_STEP_M = 4.0  # chosen: below a quarter of the shortest waves of a road's profile that carry information
_GRID_SIGMAS = 2.5  # chosen: 96 % of the prior; its tails are part of no result (`prior_share`)
_FIRST_ESTIMATE = 3.0  # chosen: slopes some metres off mislead a first estimate by less
_MOST_MINIMA = 8  # chosen
_ITERATIONS = 8  # chosen: Gauss-Newton converges in three to five
_CONVERGED_M = 0.01  # chosen: far below any σ of a shift
_AMBIGUOUS_COST = 18.4  # chi-square, 2 degrees of freedom, 99.99 %
_PRIOR_TAIL_CHI2 = 18.4  # the same
_OUTLIER_SIGMAS = 4.0  # chosen: one right observation in 16,000
_MOST_REJECTED_SHARE = 0.2  # chosen: of more, the track or the map is wrong
_REJECTED_SIGMA_M = 100.0  # chosen: any height
_GROSS_M = 1.0  # chosen: slope 2 % times the largest shift of the grid
_GROSS_DEVIATIONS = 7.4  # five σ of a normal distribution, by the median deviation
_KNOWN_SHARE = 0.8  # chosen: of the observations, on the map at a shift


class HeightWindow(NamedTuple):
    """n observations on a track whose shape is known: time (s), places (m), the road's height by the fix (its height
    less the antenna's, m), the σ of its white noise and that of the map's elevation (m).

    `white_sigma_m`: what was measured of the white noise, if it was.
    """

    time_s: Floats
    east_m: Floats
    north_m: Floats
    height_m: Floats
    sigma_m: Floats
    map_sigma_m: Floats
    white_sigma_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftEstimate:
    """True place less track: `shift` (k,) with `covariance` (k, k), of which the first two are east and north (m).

    `prior_share`: the largest share of the prior in the result over all horizontal directions, 0 to 1. `chi2` of
    `count` residuals, without those `rejected`; above `count` it scales the covariance. `unique`: no other shift has
    nearly the same cost, and few observations were rejected.
    """

    shift: Floats
    covariance: Floats
    offset_m: float
    prior_share: float
    chi2: float
    count: int
    rejected: int
    unique: bool


def estimate_shift(
    window: HeightWindow,
    terrain: TerrainAt,
    model: HeightErrorModel,
    *,
    prior: Floats,
    modes: Floats | None = None,
    max_prior_share: float = 1.0,
    starts: Sequence[Floats] | None = None,
    stepped: bool = False,
) -> ShiftEstimate | None:
    """Return the shift with least cost; None where the map covers too little of the window there, where it lies in the
    prior's tails, or where the heights leave the prior more than `max_prior_share` by a first estimate at no shift.

    `prior` (k, k): covariance of θ about zero, east and north first. `modes` (n, 2, k - 2): displacement (m) of each
    place by the further parameters, as of heading and wheel scale. `starts`, each (≤ k,): shifts to begin from; None:
    the best of a grid, which costs as much as ten of them. `stepped`: the fixes have stepped before the window.
    """
    problem = _Problem(window, terrain, model, prior=prior, modes=modes, stepped=stepped)
    if problem.prior_share_unshifted() > _FIRST_ESTIMATE * max_prior_share:
        return None
    if starts is None:
        starts = problem.best_grid_shifts()
    if not starts:
        return None
    solutions = sorted((problem.solve(start) for start in starts), key=lambda solution: solution.cost)
    best = solutions[0]
    unique = not any(_is_rival(other, best) for other in solutions[1:])
    best, rejected = _without_outliers(problem, best)
    if not problem.is_possible(best):
        return None
    count = len(window.time_s) - rejected
    covariance = best.covariance * max(1.0, best.chi2 / count)
    return ShiftEstimate(
        shift=best.shift,
        covariance=covariance,
        offset_m=best.offset_m,
        prior_share=prior_share(covariance[:2, :2], prior[:2, :2]),
        chi2=best.chi2,
        count=count,
        rejected=rejected,
        unique=unique and rejected <= _MOST_REJECTED_SHARE * len(window.time_s),
    )


def _is_rival(other: _ShiftSolution, best: _ShiftSolution) -> bool:
    """Return whether another minimum is at another place and of nearly the same cost."""
    away = other.shift[:2] - best.shift[:2]
    apart = float(away @ np.linalg.solve(best.covariance[:2, :2], away)) > _AMBIGUOUS_COST
    return apart and other.cost - best.cost < _AMBIGUOUS_COST


def _without_outliers(problem: _Problem, solution: _ShiftSolution) -> tuple[_ShiftSolution, int]:
    """Reject the observations that all others contradict, the worst first: wrong fixes, another deck, a parked lane."""
    rejected = problem.rejected
    while rejected <= _MOST_REJECTED_SHARE * problem.count and problem.reject_worst(
        solution.shift_and_offset
    ):
        rejected += 1
        solution = problem.solve(solution.shift)
    return solution, rejected


def prior_share(covariance: Floats, prior: Floats) -> float:
    """Return the largest share of the prior in a result over all directions: the largest eigenvalue of P P₀⁻¹.

    A prior that is off by d moves the result by at most `prior_share` · |d| in the prior's metric, as
    x̂ = P (P₀⁻¹ x₀ + J), J the heights' information: the prior's weight is P P₀⁻¹.
    """
    return float(np.linalg.eigvals(covariance @ np.linalg.inv(prior)).real.max())


class _ShiftSolution(NamedTuple):
    shift_and_offset: Floats
    shift: Floats
    covariance: Floats
    offset_m: float
    chi2: float
    cost: float


class _Problem:
    """One window's least-squares problem, whitened."""

    def __init__(
        self,
        window: HeightWindow,
        terrain: TerrainAt,
        model: HeightErrorModel,
        *,
        prior: Floats,
        modes: Floats | None,
        stepped: bool,
    ) -> None:
        n = len(window.time_s)
        self._window, self._terrain = window, terrain
        places = np.column_stack([window.east_m, window.north_m])
        both = np.broadcast_to(np.eye(2), (n, 2, 2))
        self._modes: Floats = both if modes is None else np.concatenate([both, modes], axis=2)
        errors = model.covariance(
            places,
            window.time_s,
            map_sigma_m=window.map_sigma_m,
            fix_sigma_m=window.sigma_m,
            white_sigma_m=window.white_sigma_m,
            stepped=stepped,
        )
        gross = self._gross_errors()
        errors[gross, gross] += _REJECTED_SIGMA_M**2
        self.rejected = int(gross.sum())
        self._errors = errors
        self._white = _whitening(errors)
        self.count = n
        self._prior_inverse = _inverse(prior)
        self._offset_var = model.offset_sigma_m**2
        self._prior = prior

    def prior_share_unshifted(self) -> float:
        """Return the prior's share with the slopes at no shift: cheap, before any search."""
        _, jacobian = self._linearised(np.zeros(len(self._prior) + 1))
        covariance = _inverse(jacobian.T @ jacobian + self._weight())
        return prior_share(covariance[:2, :2], self._prior[:2, :2])

    def _weight(self) -> Floats:
        """Return the prior's information (k + 1, k + 1), that of the offset last."""
        size = len(self._prior)
        weight = np.zeros((size + 1, size + 1))
        weight[:size, :size] = self._prior_inverse
        weight[size, size] = 1.0 / self._offset_var
        return weight

    def best_grid_shifts(self) -> list[Floats]:
        """Return the local minima of the cost over a grid of shifts east and north, best first.

        Offset and further parameters are marginalised there, linearised at no shift.
        """
        sigma = np.sqrt(np.diag(self._prior)[:2])
        axes = [_GRID_SIGMAS * s * np.linspace(-1, 1, 2 * int(_GRID_SIGMAS * s / _STEP_M) + 3) for s in sigma]
        shifts = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        residual, known = self._residuals(shifts)
        white = residual @ self._white.T
        nuisance = self._white @ self._nuisance()
        inner = nuisance.T @ nuisance
        inner += np.diag([1.0 / self._offset_var, *(1.0 / np.diag(self._prior)[2:])])
        projected = white @ nuisance
        cost = (white**2).sum(-1) - (projected * np.linalg.solve(inner, projected[..., None])[..., 0]).sum(-1)
        cost += np.einsum("...i,ij,...j->...", shifts, np.linalg.inv(self._prior[:2, :2]), shifts)
        cost[known < _KNOWN_SHARE] = np.inf
        padded = np.pad(cost, 1, constant_values=np.inf)
        rows, columns = cost.shape
        around = [
            padded[1 + i : 1 + i + rows, 1 + j : 1 + j + columns]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            if (i, j) != (0, 0)
        ]
        minima = np.isfinite(cost) & (cost <= np.min(around, axis=0))
        order = np.argsort(cost[minima])[:_MOST_MINIMA]
        return list(shifts[minima][order])

    def _gross_errors(self) -> Mask:
        """Return the heights that are metres off the others before any shift: they would mislead the search."""
        terrain = self._terrain(self._window.east_m, self._window.north_m)
        residual = self._window.height_m - terrain.elevation_m
        known = np.isfinite(residual)
        if not known.any():
            return ~known
        away = np.abs(residual - np.median(residual[known]))
        limit = max(_GROSS_M, _GROSS_DEVIATIONS * float(np.median(away[known])))
        return np.asarray(known & (away > limit), np.bool_)

    def reject_worst(self, theta: Floats) -> bool:
        """Reject the observation that contradicts all others most; return whether one does.

        With Q = C⁻¹ the residual of one observation predicted by all others is (Q r)ᵢ / Qᵢᵢ, its variance 1 / Qᵢᵢ.
        """
        whitened, _ = self._linearised(theta)
        precision = (self._white**2).sum(0)
        normalised = np.abs(self._white.T @ whitened) / np.sqrt(precision)
        worst = int(np.argmax(normalised))
        if normalised[worst] <= _OUTLIER_SIGMAS:
            return False
        self._errors[worst, worst] += _REJECTED_SIGMA_M**2
        self._white = _whitening(self._errors)
        return True

    def solve(self, start: Floats) -> _ShiftSolution:
        """Gauss-Newton from a shift (2,), or from all parameters (k,)."""
        size = len(self._prior)
        theta: Floats = np.zeros(size + 1)
        theta[: len(start)] = start
        weight = self._weight()
        for _ in range(_ITERATIONS):
            residual, jacobian = self._linearised(theta)
            normal = jacobian.T @ jacobian + weight
            change = np.linalg.solve(normal, jacobian.T @ residual - weight @ theta)
            theta = theta + change
            if np.hypot(change[0], change[1]) < _CONVERGED_M:
                break
        residual, jacobian = self._linearised(theta)
        covariance = _inverse(jacobian.T @ jacobian + weight)
        chi2 = float(residual @ residual)
        return _ShiftSolution(
            shift_and_offset=theta,
            shift=theta[:size],
            covariance=covariance[:size, :size],
            offset_m=float(theta[size]),
            chi2=chi2,
            cost=chi2 + float(theta @ weight @ theta),
        )

    def is_possible(self, solution: _ShiftSolution) -> bool:
        """Whether the shift is one of the prior's, and most of the window is on the map there.

        Few heights fit any place: without this an estimate may leave the road that contradicts it.
        """
        known = float(np.isfinite(self._terrain_moved(solution.shift).elevation_m).mean())
        place = solution.shift[:2]
        tail = float(place @ np.linalg.solve(self._prior[:2, :2], place))
        return known >= _KNOWN_SHARE and tail <= _PRIOR_TAIL_CHI2

    def _terrain_moved(self, parameters: Floats) -> TerrainHeights:
        """Return the map below the window's places, moved by the parameters (k,)."""
        moved = self._modes @ parameters
        return self._terrain(self._window.east_m + moved[:, 0], self._window.north_m + moved[:, 1])

    def _linearised(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return whitened residuals (n,) and their negative derivatives (n, k + 1)."""
        terrain = self._terrain_moved(theta[:-1])
        known = np.isfinite(terrain.elevation_m)
        residual = _interpolated(self._window.height_m - terrain.elevation_m - theta[-1], known)
        slopes = np.column_stack([terrain.slope_east, terrain.slope_north])
        slopes[~known] = 0.0
        jacobian = np.einsum("ni,nik->nk", slopes, self._modes)
        jacobian = np.column_stack([jacobian, np.ones(len(residual))])
        return self._white @ residual, self._white @ jacobian

    def _residuals(self, shifts: Floats) -> tuple[Floats, Floats]:
        """Return residuals (..., n) at shifts (..., 2), and the share of the places that are on the map."""
        terrain = self._terrain(
            self._window.east_m + shifts[..., :1], self._window.north_m + shifts[..., 1:2]
        )
        residual = self._window.height_m - terrain.elevation_m
        known = np.isfinite(residual)
        for index in np.ndindex(residual.shape[:-1]):
            residual[index] = _interpolated(residual[index], known[index])
        return residual, known.mean(-1)

    def _nuisance(self) -> Floats:
        terrain = self._terrain(self._window.east_m, self._window.north_m)
        slopes = np.nan_to_num(np.column_stack([terrain.slope_east, terrain.slope_north]))
        further = np.einsum("ni,nik->nk", slopes, self._modes[:, :, 2:])
        return np.column_stack([np.ones(len(slopes)), further])


def _whitening(covariance: Floats) -> Floats:
    """Return W with W C Wᵀ = 1."""
    return _inverse(np.asarray(np.linalg.cholesky(covariance), np.float64))


def _inverse(matrix: Floats) -> Floats:
    return np.asarray(np.linalg.inv(matrix), np.float64)


def _interpolated(residual: Floats, known: Mask) -> Floats:
    """Give a place without a road the residual of its neighbours: with correlated errors it adds nearly nothing."""
    if known.all() or not known.any():
        return np.nan_to_num(residual)
    index = np.arange(len(residual))
    return np.asarray(np.interp(index, index[known], residual[known]), np.float64)
