"""A position under the hypothesis that all fixes are off by one vector, or that the map is shifted.

Wrong base coordinate, fixes that are led away, a captured pose: candidate and pose are then off alike, by a vector b.
With the candidate x = truth + b and the independent position y = truth + e, e ~ N(0, C), their difference
d = x − y = b − e is known, and the error of the candidate is

    x − truth = d + e ~ N(d, C)

whatever b is: the bound is the distance to the independent position and the error that this has by its sensors and
calibrations since its last evidence. C grows with the way driven, and the level with it. If the independent position
is at fault too, by a vector N(0, M) of another cause, the error is N(d, C + M). The weights are
`common_fault_probability`. Solution separation (Blanch et al. 2015, IEEE Trans. AES 51(1), 713–732) bounds a faulted
subset in the same way, by the distance to the solution that does not use it.

A wrong fix that has passed and taken the pose along (`latent_fault`) is such a fault, of which more is known: its error
is N(0, G), so with d at most N(d, 2 (G⁻¹ + C⁻¹)⁻¹). The factor is 1 if the errors of both positions are independent,
which those of a pose and of the independent position, by the same odometry and matches, are not: their conditional
covariance T has T ⪯ G and T ⪯ C, hence T⁻¹ ⪰ (G⁻¹ + C⁻¹) / 2.

A shifted map shifts the independent position with it, and whatever position the map gives. Its prior is small beside
the others: of a candidate of the fixes it counts together with a common fault, of a candidate of the map alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from camber.integrity.checks.independent_position import OffsetFromIndependent, offset_from_independent
from camber.integrity.protection.common_fault_probability import (
    CommonFaultOdds,
    CommonFaultRules,
    HorizontalColumns,
    common_fault_odds,
    determinant,
    likelihood_ratio,
)
from camber.integrity.protection.position_bounds import (
    ErrorMixture,
    Horizontal,
    LevelRules,
    MixtureComponent,
)
from camber.integrity.protection.position_candidates import PositionCandidate, road_components
from camber.integrity.scalar_or_array import FloatOrArray
from camber.schemas.pose import Pose

_LEAST_SHARE = 1e-13
"""Chosen: beside a latent fault that is certain in floats; its odds are then those of `MOST_LOG_ODDS`."""


def with_common_fault(
    candidate: PositionCandidate, pose: Pose | None, rules: LevelRules
) -> PositionCandidate | None:
    """The candidate with these hypotheses too; None where the pose has no independent position to see them by."""
    latitude_rad, longitude_rad, _ = candidate.geodetic
    offset = (
        offset_from_independent(latitude_rad, longitude_rad, pose, candidate.time_ns)
        if pose is not None
        else None
    )
    if pose is None or offset is None:
        return None
    faults = rules.common_fault
    parts = [part for part in candidate.mixture.parts if not part.is_latent]
    latent = _LatentFaults(
        [part for part in candidate.mixture.parts if part.is_latent and part.weight != 0.0]
    )
    rest = max(1.0 - sum(part.weight for part in latent.parts), _LEAST_SHARE)
    if_right_m2 = _sum(_horizontal(candidate), offset.covariance_m2)
    odds = common_fault_odds(offset.difference_m, if_right_m2, faults)
    alone, with_independent = latent.weights_after(offset, if_right_m2, faults)
    total = 1.0 + odds.alone + odds.with_independent + sum(alone + with_independent) / rest
    of_the_map = candidate.source in ("sensors", "scan_match")
    if of_the_map:
        parts = _with_shifted_map(parts, faults)
    share = 1.0 / (rest * total)
    mixture = ErrorMixture(
        (
            *(part.weighed(share) for part in parts),
            *latent.bounded([share * weight for weight in alone], offset, shares_errors=of_the_map),
            *latent.unbounded([share * weight for weight in with_independent]),
            *_common_fault_parts(candidate, offset, odds=odds, total=total, rules=rules),
        ),
        candidate.mixture.lost,
    )
    return replace(candidate, mixture=mixture)


class _LatentFaults:
    """The latent faults of a candidate, compared with the independent position all at once."""

    def __init__(self, parts: list[MixtureComponent]) -> None:
        self.parts = parts
        rows = [(part.weight, *part.mean_m, *part.horizontal_m2) for part in parts]
        self._weight, *self._mean_m, _, ee, en, nn = np.reshape(rows, (-1, 7)).T
        self._horizontal_m2 = ee, en, nn

    def weights_after(
        self, offset: OffsetFromIndependent, if_right_m2: Horizontal, faults: CommonFaultRules
    ) -> tuple[list[float], list[float]]:
        """Relative to those of the other parts; where the candidate alone is at fault, and both positions."""
        (east_m, north_m), (mean_east_m, mean_north_m) = offset.difference_m, self._mean_m
        prior, fault_m2 = np.array([[1.0, faults.independent_prior], [0.0, faults.independent_sigma_m**2]])
        ratio = likelihood_ratio(
            (east_m - mean_east_m, north_m - mean_north_m),
            _plus(_sum(self._horizontal_m2, offset.covariance_m2), fault_m2[:, None]),
            offset.difference_m,
            if_right_m2,
        )
        alone, both = (prior[:, None] * ratio * self._weight).tolist()
        return alone, both

    def bounded(
        self, weights: list[float], offset: OffsetFromIndependent, *, shares_errors: bool
    ) -> Iterator[MixtureComponent]:
        """With these weights, and where the independent position says, which is right."""
        covariances_m2 = _conditional(self._horizontal_m2, offset.covariance_m2, shares_errors)
        columns = zip(*(column.tolist() for column in covariances_m2), strict=True)
        east_m, north_m = offset.difference_m
        for part, weight, (ee, en, nn) in zip(self.parts, weights, columns, strict=True):
            mean_m = east_m, north_m, part.mean_m[2]
            yield MixtureComponent(weight, (ee, en, nn), part.up_m2, mean_m, is_latent=True)

    def unbounded(self, weights: list[float]) -> Iterator[MixtureComponent]:
        """With these weights, and as before: the independent position is at fault too."""
        return (MixtureComponent(weight, *part[1:]) for part, weight in zip(self.parts, weights, strict=True))


def _conditional(
    one_m2: HorizontalColumns, other_m2: HorizontalColumns, shares_errors: bool
) -> HorizontalColumns:
    """(A⁻¹ + B⁻¹)⁻¹ = (det A · B + det B · A) / det(A + B), twice where the errors may have a part in common.

    In two dimensions, by adj(A) = tr(A) 1 − A.
    """
    det_one, det_other, total = (
        determinant(one_m2),
        determinant(other_m2),
        determinant(_sum(one_m2, other_m2)),
    )
    scale = (2.0 if shares_errors else 1.0) / total
    a, b, c = (
        scale * (det_one * other + det_other * one) for one, other in zip(one_m2, other_m2, strict=True)
    )
    return a, b, c


def _horizontal(candidate: PositionCandidate) -> Horizontal:
    ee, en, _, nn, _, _ = candidate.covariance_enu_m2
    return ee, en, nn


def _sum(one_m2: HorizontalColumns, other_m2: HorizontalColumns) -> HorizontalColumns:
    return one_m2[0] + other_m2[0], one_m2[1] + other_m2[1], one_m2[2] + other_m2[2]


def _plus(covariance_m2: HorizontalColumns, variance_m2: FloatOrArray) -> HorizontalColumns:
    ee, en, nn = covariance_m2
    return ee + variance_m2, en, nn + variance_m2


def _common_fault_parts(
    candidate: PositionCandidate,
    offset: OffsetFromIndependent,
    *,
    odds: CommonFaultOdds,
    total: float,
    rules: LevelRules,
) -> tuple[MixtureComponent, ...]:
    """Where the vehicle is if only the independent position shows it, or a map that is shifted, or not even that."""
    faults, (mean_up_m, up_m2) = rules.common_fault, candidate.up_by_road_m
    off = MixtureComponent(
        weight=1.0,
        mean_m=(*offset.difference_m, mean_up_m),
        horizontal_m2=offset.covariance_m2,
        up_m2=up_m2,
    )
    share = faults.map_shift_prior
    return (
        *road_components(off, (1.0 - share) * odds.alone / total, rules),
        *road_components(_wider(off, faults.map_shift_sigma_m), share * odds.alone / total, rules),
        *road_components(_wider(off, faults.independent_sigma_m), odds.with_independent / total, rules),
    )


def _with_shifted_map(parts: list[MixtureComponent], faults: CommonFaultRules) -> list[MixtureComponent]:
    """Of a position that the map gives: its first part, once more on a map that is shifted."""
    first, share = parts[0], faults.map_shift_prior
    shifted = _wider(first, faults.map_shift_sigma_m).weighed(share)
    return [first.weighed(1.0 - share), *parts[1:], shifted]


def _wider(part: MixtureComponent, sigma_m: float) -> MixtureComponent:
    return part._replace(horizontal_m2=_plus(part.horizontal_m2, sigma_m**2))
