"""The errors that the lab assumes besides wrong integers, and none of the judge's numbers.

What a fix, a pose, a map and an antenna *claim* is what the product would claim; how wrong they *are* is here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from camber.formats.observations import Floats
from camber.integrity.rules import Rules
from camber.road_map.map_error_model import MAP_ERRORS, MapErrorModel


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumptions:
    """σ in metres, times in seconds. Gauss-Markov throughout: neighbouring epochs are alike.

    Fix: the reflections of its phases through its own geometry (`reflection_time_s`); reference point of antenna and
    map, another for each vehicle, normal with a mean square of `reference_m`² in the plane and half of it upwards,
    constant in an episode; frame of base and map, `frame_sigma_m`. One vehicle is all that was measured, Nagoya's,
    whose reference point is 5.6 cm off horizontally and 4.5 cm low: others may be farther off, and no bound of it is
    known. Map: two scales along the road (`camber.road_map.map_error_model`); what the common offset of a survey leaves
    after it was learnt is in `reference_m`. A share `standing` of all episodes is of vehicles that stand, the
    others drive at 2 to 15 m/s. Antenna: half of its variance is constant, the other half dynamic. Slopes of roads,
    each axis.
    """

    epochs_per_s: float = 10.0
    shortest_s: float = 1.0
    longest_s: float = 120.0
    reflection_time_s: tuple[float, float] = (2.0, 10.0)
    reference_m: float = 0.06
    frame_sigma_m: float = 0.02
    pose_time_s: float = 10.0
    map_short_share: float = MAP_ERRORS.short_share
    map_short_m: float = MAP_ERRORS.short_m
    map_long_m: float = MAP_ERRORS.long_m
    standing: float = 0.25
    antenna_sigma_m: float = 0.02
    antenna_time_s: float = 1.5
    slope_sigma: float = 0.03

    @property
    def map_errors(self) -> MapErrorModel:
        """The model of the map's error along the road."""
        return MapErrorModel(
            short_share=self.map_short_share, short_m=self.map_short_m, long_m=self.map_long_m
        )

    @property
    def constant_variance_m2(self) -> float:
        """Of reference point and frame together, each axis."""
        return 0.5 * self.reference_m**2 + self.frame_sigma_m**2


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """How well pose and map are known: true σ, and what is claimed of it."""

    pose_sigma_m: float
    map_sigma_m: float

    @property
    def name(self) -> str:
        """For tables and seeds."""
        return f"LiDAR {self.pose_sigma_m:.2f} m, map {self.map_sigma_m:.2f} m"


ASSUMPTIONS = Assumptions()
HEADLINE = tuple(Scene(pose_sigma_m=sigma_m, map_sigma_m=0.05) for sigma_m in (0.05, 0.10))
"""The scenes that requirements are stated for; bounds and faults are those of the first."""


def scene_of(row: dict[str, Any]) -> Scene:
    """The scene of a row of the lab's figures."""
    return Scene(pose_sigma_m=row["pose_sigma_m"], map_sigma_m=row["map_sigma_m"])


def inflated_covariance(claimed_m2: Floats, rules: Rules) -> Floats:
    """Covariances (n, 3, 3) of right fixes from the claimed ones, by the judge's rule (`inflate_covariance`)."""
    true = rules.true_sigma
    floor = np.diag([true.horizontal_m**2, true.horizontal_m**2, true.vertical_m**2])
    return np.asarray(true.scale**2 * claimed_m2 + floor)


def largest_variance(covariance_m2: Floats) -> Floats:
    """The variance (n,) along the widest horizontal axis of covariances (n, k, k)."""
    ee, en, nn = covariance_m2[:, 0, 0], covariance_m2[:, 0, 1], covariance_m2[:, 1, 1]
    return np.asarray(0.5 * (ee + nn) + np.hypot(0.5 * (ee - nn), en))
