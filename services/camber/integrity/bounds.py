"""The bounds of positions: error ellipses of 99 % and 99.9 % and protection levels at an integrity risk.

All are those of the same mixture: the position is right with its covariance, or a wrong fix stands behind it with the
weight, mean and covariance of each way in which that may be so (`wrong_fix`, `protection_level`). The ellipses have the
shape of the first part and the size that holds the mixture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from camber.geodesy.covariance import eigenvalues_m2
from camber.integrity.doppler_position import DopplerRules
from camber.integrity.protection_level import Floats, horizontal, levels_m, whitened
from camber.integrity.wrong_fix import WrongFixRules

_P99, _P999 = 0.99, 0.999
# A tenth of a millimetre keeps an ellipse of one that is sure in some direction.
_LEAST_M2, _UNIT = 1e-8, np.eye(2)
_SURELY = 1.01  # levels are found to a ten-thousandth of the risk


@dataclass(frozen=True, slots=True)
class IndexRules:
    """R's formulas: σ of a confirmed fix, and how much σ each 0.1 s by Doppler and by the vehicle's sensors adds.

    The levels are those of the error ellipse that holds `probability`.
    """

    probability: float = 0.99
    rtk_m: float = 0.025
    doppler_m: float = 0.02
    sensors_m: float = 0.03


@dataclass(frozen=True, slots=True)
class LevelRules:
    """At which risk levels hold, which are usable, and what is assumed.

    `pose_fault_prior`: the probability, each epoch, that a pose or a satellite velocity is off in a way that neither
    its covariance tells nor any test has shown. `horizontal_margin` scales horizontal σ: with 1.03 the ellipses of a
    normal error hold 99.25 and 99.93 %, so that 3 % of error in a σ do not break the promise. A lower mode is taken
    where its level is less than `clearly_smaller` of that of the mode above.
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


@dataclass(frozen=True, slots=True)
class Part:
    """One way in which the position may be off: its weight, mean east, north, up, (ee, en, nn), and uu.

    `up_m2` infinite: the height is not known.
    """

    weight: float
    mean_m: tuple[float, float, float]
    horizontal_m2: tuple[float, float, float]
    up_m2: float


@dataclass(frozen=True, slots=True)
class Mixture:
    """All ways, the right one first; `lost`: the probability of what no bound covers. With it they make one."""

    parts: tuple[Part, ...]
    lost: float = 0.0


@dataclass(frozen=True, slots=True)
class Bounds:
    """Metres; infinite where there is none."""

    semi_major_99_m: float
    semi_minor_99_m: float
    semi_major_999_m: float
    semi_minor_999_m: float
    orientation_rad: float
    horizontal_level_m: float
    vertical_level_m: float


def bounds_of(mixtures: Sequence[Mixture], rules: LevelRules) -> list[Bounds]:
    """Of several positions at once."""
    n, k = len(mixtures), max(len(mixture.parts) for mixture in mixtures)
    table = np.array([_rows(mixture, k) for mixture in mixtures])
    margin2 = rules.horizontal_margin**2
    # Four times: ellipses of 99 and of 99.9 %, horizontal, vertical.
    weight, mean, covariance = np.empty((4, n, k)), np.zeros((4, n, k, 2)), np.zeros((4, n, k, 2, 2))
    weight[:] = table[..., 0]
    mean[2], mean[3, ..., 0] = table[..., 1:3], table[..., 3]
    covariance[2] = margin2 * table[..., 4:8].reshape(n, k, 2, 2) + _LEAST_M2 * _UNIT
    # Heights are on a line: a horizontal error to the east alone.
    covariance[3, ..., 0, 0] = table[..., 8]
    mean[:2], covariance[:2] = whitened(mean[2], covariance[2])
    rows = 4 * n
    tails = horizontal(weight.reshape(rows, k), mean.reshape(rows, k, 2), covariance.reshape(rows, k, 2, 2))
    lost = np.array([mixture.lost for mixture in mixtures])
    risks = (1.0 - _P99, 1.0 - _P999, rules.integrity_risk, rules.integrity_risk)
    found = levels_m(tails, np.concatenate([risk - lost for risk in risks])).reshape(4, n)
    return [_bounds(covariance[2, row, 0], found[:, row]) for row in range(n)]


def is_beyond(mixture: Mixture, level_m: float, rules: LevelRules) -> bool:
    """Is the horizontal level surely larger than this? By the errors along each part's major axis alone."""
    probability = mixture.lost
    for part in mixture.parts:
        ee, en, nn = part.horizontal_m2
        larger_m2 = 0.5 * (ee + nn) + math.hypot(0.5 * (ee - nn), en)
        if not larger_m2 > 0.0:
            continue
        sigma_m = rules.horizontal_margin * math.sqrt(larger_m2)
        probability += part.weight * math.erfc(level_m / (math.sqrt(2.0) * sigma_m))
    return probability > _SURELY * rules.integrity_risk


def _rows(mixture: Mixture, parts: int) -> list[tuple[float, ...]]:
    """Weight, mean (3), covariance (4), and variance upwards of each part; more of no weight up to this many."""
    rows: list[tuple[float, ...]] = [
        (part.weight, *part.mean_m, ee, en, en, nn, part.up_m2)
        for part in mixture.parts
        for ee, en, nn in [part.horizontal_m2]
    ]
    first = rows[0][4:8]
    return rows + [(0.0, 0.0, 0.0, 0.0, *first, 1.0)] * (parts - len(rows))


def _bounds(covariance_m2: Floats, levels: Floats) -> Bounds:
    scale_99, scale_999, horizontal_m, vertical_m = (float(level) for level in levels)
    ee, en, nn = float(covariance_m2[0, 0]), float(covariance_m2[0, 1]), float(covariance_m2[1, 1])
    major, minor = (math.sqrt(value) for value in eigenvalues_m2((ee, en, nn)))
    return Bounds(
        scale_99 * major,
        scale_99 * minor,
        scale_999 * major,
        scale_999 * minor,
        0.5 * math.atan2(2.0 * en, ee - nn),
        horizontal_m,
        vertical_m,
    )
