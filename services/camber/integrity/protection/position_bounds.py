"""The bounds of positions: error ellipses of 99 % and 99.9 % and protection levels at an integrity risk.

All are those of the same mixture: the position is right with its covariance, or a wrong fix stands behind it with the
weight, mean and covariance of each way in which that may be so (`position_candidates`). The ellipses have the
shape of the first part and the size that holds the mixture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from camber.geodesy.covariance import eigenvalues_m2
from camber.integrity.protection.common_fault_probability import CommonFaultRules
from camber.integrity.protection.doppler_position import DopplerRules
from camber.integrity.protection.protection_level import TailComponent, levels_m
from camber.integrity.protection.wrong_fix_probability import WrongFixRules
from camber.integrity.scalar_or_array import FloatOrArray, larger_eigenvalue

_P99, _P999 = 0.99, 0.999
# A tenth of a millimetre keeps an ellipse of one that is sure in some direction.
_LEAST_M2 = 1e-8
_SURELY = 1.01  # levels are found to a ten-thousandth of the risk


Horizontal = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class IndexRules:
    """Kikuchi (TUMSAT), reliability index: σ of a confirmed fix, and its growth each 0.1 s by Doppler and by sensors.

    The levels are those of the error ellipse that holds `probability`.
    """

    probability: float = 0.99
    rtk_m: float = 0.025
    doppler_m: float = 0.02
    sensors_m: float = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelRules:
    """At which risk levels hold, which are usable, and what is assumed.

    `pose_fault_prior`: the probability, each epoch, that a pose or a satellite velocity is off in a way that neither
    its covariance includes nor any test has shown. `horizontal_margin` scales horizontal σ: with 1.03 the ellipses of a
    normal error hold 99.25 and 99.93 %, so that 3 % of error in a σ do not break the promise. A lower mode is taken
    where its level is less than `clearly_smaller` of that of the mode above.

    `false_match_prior`: how likely scan matching confirms a pose that a wrong fix has pulled metres off; at places
    `matches_apart_m` apart it would have to do so anew.

    `changed_road_prior`: how likely the road under a pose has changed since it was surveyed, by a height of the
    standard deviation `changed_road_sigma_m`.

    `disputed_pose_prior`: how likely it is the pose that is wrong where a fix at the height of the road contradicts it.
    """

    levels: Literal["integrity_risk", "reliability_index"] = "integrity_risk"
    integrity_risk: float = 1e-7
    vertical_alert_limit_m: float = 2.0
    pose_fault_prior: float = 1e-8
    horizontal_margin: float = 1.03
    clearly_smaller: float = 0.7
    time_to_alert_s: float = 0.3
    wrong_fix: WrongFixRules = field(default_factory=WrongFixRules)
    doppler: DopplerRules = field(default_factory=DopplerRules)
    index: IndexRules = field(default_factory=IndexRules)
    false_match_prior: float = 1e-3
    matches_apart_m: float = 20.0
    changed_road_prior: float = 1e-2
    changed_road_sigma_m: float = 0.2
    disputed_pose_prior: float = 1e-3
    common_fault: CommonFaultRules = field(default_factory=CommonFaultRules)


class MixtureComponent(NamedTuple):
    """One way in which the position may be off: its weight, mean east, north, up, (ee, en, nn), and uu.

    `up_m2` infinite: the height is not known. `is_latent`: a fault that has taken fixes and pose along, so that they
    agree; only the independent position shows it.
    """

    weight: float
    horizontal_m2: Horizontal
    up_m2: float
    mean_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    is_latent: bool = False

    def weighed(self, share: float) -> MixtureComponent:
        """The same with a share of its weight."""
        return MixtureComponent(share * self.weight, *self[1:])


def widened(part: MixtureComponent, covariance: Sequence[float]) -> MixtureComponent:
    """The part with the errors of a covariance (ee, en, eu, nn, nu, uu) [m²] added."""
    (ee, en, nn), (added_ee, added_en, _, added_nn, _, added_uu) = part.horizontal_m2, covariance
    wider_m2 = ee + added_ee, en + added_en, nn + added_nn
    return MixtureComponent(part.weight, wider_m2, part.up_m2 + added_uu, *part[3:])


@dataclass(frozen=True, slots=True)
class ErrorMixture:
    """All ways, the right one first; `lost`: the probability of what no bound covers. With it they make one."""

    parts: tuple[MixtureComponent, ...]
    lost: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Metres; infinite where there is none."""

    semi_major_99_m: float
    semi_minor_99_m: float
    semi_major_999_m: float
    semi_minor_999_m: float
    orientation_rad: float
    horizontal_level_m: float
    vertical_level_m: float


def bounds_of(mixtures: Sequence[ErrorMixture], rules: LevelRules) -> list[Bounds]:
    """Of several positions at once."""
    firsts = [_right(mixture, rules) for mixture in mixtures]
    tails = [_tails(mixture, first, rules) for mixture, first in zip(mixtures, firsts, strict=True)]
    if len(mixtures) == 1:  # in plain floats
        return [_bounds(firsts[0], _levels(tails[0], mixtures[0].lost, rules))]
    lost = np.array([mixture.lost for mixture in mixtures])
    levels = np.array(_levels([_columns(of_each) for of_each in zip(*tails, strict=True)], lost, rules))
    return [_bounds(first, level) for first, level in zip(firsts, levels.T.tolist(), strict=True)]


def _columns(of_each: Sequence[Sequence[TailComponent]]) -> list[TailComponent]:
    """The parts of several as one mixture of arrays: to those that have fewer, some of no weight."""
    nothing, k = (0.0, 0.0, 0.0, 1.0, 1.0), max(map(len, of_each))
    table = np.array([[*parts, *[nothing] * (k - len(parts))] for parts in of_each])
    return [tuple(columns) for columns in np.ascontiguousarray(table.transpose(1, 2, 0))]


def _levels(
    tails: Sequence[Sequence[TailComponent]], lost: FloatOrArray, rules: LevelRules
) -> list[FloatOrArray]:
    """Scales of the ellipses of 99 and of 99.9 %, horizontal and vertical level."""
    standard, metres, upwards = tails
    risk = rules.integrity_risk - lost
    ellipses = levels_m(standard, [1.0 - _P99 - lost, 1.0 - _P999 - lost])
    return [*ellipses, *levels_m(metres, [risk]), *levels_m(upwards, [risk])]


def is_beyond(mixture: ErrorMixture, level_m: float, rules: LevelRules) -> bool:
    """Is the horizontal level surely larger than this? By the errors along each part's major axis alone."""
    probability = mixture.lost
    for part in mixture.parts:
        larger_m2 = larger_eigenvalue(*part.horizontal_m2)
        if not larger_m2 > 0.0:
            continue
        sigma_m = rules.horizontal_margin * math.sqrt(larger_m2)
        probability += part.weight * math.erfc(level_m / (math.sqrt(2.0) * sigma_m))
    return probability > _SURELY * rules.integrity_risk


def _right(mixture: ErrorMixture, rules: LevelRules) -> Horizontal:
    """(ee, en, nn) of the first part, as the ellipses take it."""
    return _with_margin(mixture.parts[0].horizontal_m2, rules)


def _with_margin(horizontal_m2: Horizontal, rules: LevelRules) -> Horizontal:
    margin2, (ee, en, nn) = rules.horizontal_margin**2, horizontal_m2
    return margin2 * ee + _LEAST_M2, margin2 * en, margin2 * nn + _LEAST_M2


def _tails(mixture: ErrorMixture, first: Horizontal, rules: LevelRules) -> list[list[TailComponent]]:
    """Of the parts what their tails take: in σ of the first part, in metres, and upwards. What is alike is one."""
    in_plane: dict[tuple[float, float, Horizontal], float] = {}
    on_line: dict[tuple[float, float], float] = {}
    for part in mixture.parts:
        east, north, up = part.mean_m
        plane, line = (east, north, part.horizontal_m2), (up, part.up_m2)
        in_plane[plane] = in_plane.get(plane, 0.0) + part.weight
        on_line[line] = on_line.get(line, 0.0) + part.weight
    ee, en, nn = first
    rest = nn - en * en / ee if ee > 0.0 else math.nan
    # The inverse of the lower Cholesky factor [[p, 0], [q, r]]: no numbers where the first part has no ellipse.
    p, r = (1.0 / math.sqrt(ee), 1.0 / math.sqrt(rest)) if rest > 0.0 else (math.nan, math.nan)
    q = -en / ee * r
    standard, metres = list[TailComponent](), list[TailComponent]()
    for (east, north, horizontal_m2), weight in in_plane.items():
        ee, en, nn = _with_margin(horizontal_m2, rules)
        mixed = q * ee + r * en
        white = p * p * ee, p * mixed, q * mixed + r * (q * en + r * nn)
        standard.append((weight, *_axes(p * east, q * east + r * north, white)))
        metres.append((weight, *_axes(east, north, (ee, en, nn))))
    # Heights are on a line: a horizontal error to the east alone.
    return [standard, metres, [(weight, up, 0.0, up_m2, 0.0) for (up, up_m2), weight in on_line.items()]]


def _axes(east: float, north: float, covariance: Horizontal) -> tuple[float, float, float, float]:
    """A mean along and across the major axis, and the larger and the smaller variance."""
    ee, en, nn = covariance
    middle, spread = 0.5 * (ee + nn), math.hypot(0.5 * (ee - nn), en)
    if east == north == 0.0:
        return 0.0, 0.0, middle + spread, middle - spread
    tilt = 0.5 * math.atan2(2.0 * en, ee - nn)
    c, s = math.cos(tilt), math.sin(tilt)
    return c * east + s * north, c * north - s * east, middle + spread, middle - spread


def _bounds(first: Horizontal, levels: Sequence[float]) -> Bounds:
    scale_99, scale_999, horizontal_m, vertical_m = levels
    ee, en, nn = first
    major, minor = (math.sqrt(value) for value in eigenvalues_m2(first))
    return Bounds(
        semi_major_99_m=scale_99 * major,
        semi_minor_99_m=scale_99 * minor,
        semi_major_999_m=scale_999 * major,
        semi_minor_999_m=scale_999 * minor,
        orientation_rad=0.5 * math.atan2(2.0 * en, ee - nn),
        horizontal_level_m=horizontal_m,
        vertical_level_m=vertical_m,
    )
