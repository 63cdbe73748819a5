"""A position under the hypothesis that all fixes are off by one vector, or that the map is shifted.

Wrong base coordinate, fixes that are led away, a captured pose, a wrong fix that has passed and taken the pose along
(`latent_fault`): candidate and pose are then off alike, by a vector b. With the candidate x = truth + b and the
independent position y = truth + e, e ~ N(0, C), their difference d = x − y = b − e is known, and the error of the
candidate is

    x − truth = d + e ~ N(d, C)

whatever b is: the bound is the distance to the independent position and the error that this has by its sensors and
calibrations since its last evidence. C grows with the way driven, and the level with it. If the independent position
is at fault too, by a vector N(0, M) of another cause, the error is N(d, C + M). The weights are
`common_fault_probability`. Solution separation (Blanch et al. 2015, IEEE Trans. AES 51(1), 713–732) bounds a faulted
subset in the same way, by the distance to the solution that does not use it.

A shifted map shifts the independent position with it, and whatever position the map gives. Its prior is small beside
the others: of a candidate of the fixes it counts together with a common fault, of a candidate of the map alone.
"""

from __future__ import annotations

from dataclasses import replace

from camber.integrity.checks.independent_position import OffsetFromIndependent, offset_from_independent
from camber.integrity.protection.common_fault_probability import (
    CommonFaultOdds,
    CommonFaultRules,
    common_fault_odds,
)
from camber.integrity.protection.position_bounds import (
    ErrorMixture,
    Horizontal,
    LevelRules,
    MixtureComponent,
)
from camber.integrity.protection.position_candidates import PositionCandidate, road_components
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
    latent = sum(part.weight for part in candidate.mixture.parts if part.is_latent)
    rest = max(1.0 - latent, _LEAST_SHARE)
    odds = _odds(candidate, offset, faults.prior_odds + latent / rest, faults)
    total = 1.0 + odds.alone + odds.with_independent
    if candidate.source in ("sensors", "scan_match"):
        parts = _with_shifted_map(parts, faults)
    mixture = ErrorMixture(
        (
            *(_weighed(part, 1.0 / (rest * total)) for part in parts),
            *_common_fault_parts(candidate, offset, odds=odds, total=total, rules=rules),
        ),
        candidate.mixture.lost,
    )
    return replace(candidate, mixture=mixture)


def _odds(
    candidate: PositionCandidate, offset: OffsetFromIndependent, prior_odds: float, faults: CommonFaultRules
) -> CommonFaultOdds:
    ee, en, _, nn, _, _ = candidate.covariance_enu_m2
    c_ee, c_en, c_nn = offset.covariance_m2
    return common_fault_odds(offset.difference_m, (ee + c_ee, en + c_en, nn + c_nn), prior_odds, faults)


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
    shifted = replace(_wider(first, faults.map_shift_sigma_m), weight=share * first.weight)
    return [_weighed(first, 1.0 - share), *parts[1:], shifted]


def _wider(part: MixtureComponent, sigma_m: float) -> MixtureComponent:
    ee, en, nn = part.horizontal_m2
    wider: Horizontal = (ee + sigma_m**2, en, nn + sigma_m**2)
    return replace(part, horizontal_m2=wider)


def _weighed(part: MixtureComponent, share: float) -> MixtureComponent:
    return replace(part, weight=share * part.weight)
