"""A position under the hypothesis that all fixes are off by one vector, or that the map is shifted.

Wrong base coordinate, fixes that are led away, a captured pose: candidate and pose are then off alike, by a vector b of
which nothing is known beforehand. With the candidate x = truth + b and the independent position y = truth + e, e ~ N(0,
C), their difference d = x − y = b − e is known, and the error of the candidate is

    x − truth = d + e ~ N(d, C)

whatever b is: the bound is the distance to the independent position and the error that this has by its sensors and
calibrations since its last evidence. C grows with the way driven, and the level with it. The weight is
`common_fault_probability`. Solution separation (Blanch et al. 2015, IEEE Trans. AES 51(1), 713–732) bounds a
faulted subset in the same way, by the distance to the solution that does not use it.

A shifted map shifts the independent position with it, by M, and whatever position the map gives. Its prior is small
beside the others: of a candidate of the fixes it counts together with a common fault, of a candidate of the map alone.
"""

from __future__ import annotations

from dataclasses import replace

from camber.integrity.checks.consistency import horizontal_distance2
from camber.integrity.checks.independent_position import OffsetFromIndependent, offset_from_independent
from camber.integrity.protection.common_fault_probability import CommonFaultRules, common_fault_odds
from camber.integrity.protection.position_bounds import (
    ErrorMixture,
    Horizontal,
    LevelRules,
    MixtureComponent,
)
from camber.integrity.protection.position_candidates import PositionCandidate, road_components
from camber.schemas.pose import Pose


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
    odds = _odds(candidate, offset, faults)
    total = 1.0 + odds
    mean_up_m, up_m2 = candidate.up_by_road_m
    off = MixtureComponent(
        weight=1.0,
        mean_m=(*offset.difference_m, mean_up_m),
        horizontal_m2=offset.covariance_m2,
        up_m2=up_m2,
    )
    shifted = replace(off, horizontal_m2=_shifted(off.horizontal_m2, faults))
    share = faults.map_shift_prior
    parts = candidate.mixture.parts
    if candidate.source in ("sensors", "scan_match"):
        parts = _with_shifted_map(parts, faults)
    mixture = ErrorMixture(
        (
            *(_weighed(part, 1.0 / total) for part in parts),
            *road_components(off, (1.0 - share) * odds / total, rules),
            *road_components(shifted, share * odds / total, rules),
        ),
        candidate.mixture.lost,
    )
    return replace(candidate, mixture=mixture)


def _odds(candidate: PositionCandidate, offset: OffsetFromIndependent, faults: CommonFaultRules) -> float:
    ee, en, _, nn, _, _ = candidate.covariance_enu_m2
    c_ee, c_en, c_nn = offset.covariance_m2
    squared = horizontal_distance2(*offset.difference_m, (ee + c_ee, en + c_en, nn + c_nn))
    return common_fault_odds(squared, faults)


def _with_shifted_map(
    parts: tuple[MixtureComponent, ...], faults: CommonFaultRules
) -> tuple[MixtureComponent, ...]:
    """Of a position that the map gives: its first part, once more on a map that is shifted."""
    first, share = parts[0], faults.map_shift_prior
    shifted = replace(first, weight=share * first.weight, horizontal_m2=_shifted(first.horizontal_m2, faults))
    return (_weighed(first, 1.0 - share), *parts[1:], shifted)


def _shifted(horizontal_m2: Horizontal, faults: CommonFaultRules) -> Horizontal:
    ee, en, nn = horizontal_m2
    map_m2 = faults.map_shift_sigma_m**2
    return ee + map_m2, en, nn + map_m2


def _weighed(part: MixtureComponent, share: float) -> MixtureComponent:
    return replace(part, weight=share * part.weight)
