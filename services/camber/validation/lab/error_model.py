"""What the lab assumes of errors that are no wrong integers: every number of it, named, and none of the judge's.

What a fix, a pose, a map and an antenna *claim* is what the product would claim; how wrong they *are* is here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.integrity.checks.chi2_test import difference_covariance
from camber.integrity.rules import Rules

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Assumptions:
    """σ in metres, times in seconds. Gauss-Markov throughout: neighbouring epochs are alike.

    Fix: the reflections of its phases through its own geometry (`reflection_time_s`); reference point of antenna and
    map, another for each vehicle, normal with a mean square of `reference_m`² in the plane and half of it upwards,
    constant in an episode; frame of base and map, `frame_sigma_m`. One vehicle is all that was measured, Nagoya's,
    whose reference point is 5.6 cm aside and 4.5 cm low: others may be farther off, and no bound of it is known. Map:
    over `map_length_m` of driving. A share `standing` of all episodes is of vehicles that stand, the others drive at 2
    to 15 m/s. Antenna: half of its variance is constant, the other half dynamic. Slopes of roads, each axis.
    """

    epochs_per_s: float = 10.0
    shortest_s: float = 1.0
    longest_s: float = 120.0
    reflection_time_s: tuple[float, float] = (2.0, 10.0)
    reference_m: float = 0.06
    frame_sigma_m: float = 0.02
    pose_time_s: float = 10.0
    map_length_m: float = 20.0
    standing: float = 0.25
    antenna_sigma_m: float = 0.02
    antenna_time_s: float = 1.5
    slope_sigma: float = 0.03

    @property
    def constant_variance_m2(self) -> float:
        """Of reference point and frame together, each axis."""
        return 0.5 * self.reference_m**2 + self.frame_sigma_m**2


@dataclass(frozen=True, slots=True)
class Scene:
    """How well pose and map are known: true σ, and what is claimed of it."""

    pose_sigma_m: float
    map_sigma_m: float

    @property
    def name(self) -> str:
        """For tables and seeds."""
        return f"LiDAR {self.pose_sigma_m:.2f} m, map {self.map_sigma_m:.2f} m"


ASSUMPTIONS = Assumptions()


def inflated_covariance(claimed_m2: Floats, rules: Rules) -> Floats:
    """Covariances (n, 3, 3) of right fixes from the claimed ones, by the judge's rule (`inflate_covariance`)."""
    true = rules.true_sigma
    floor = np.diag([true.horizontal_m**2, true.horizontal_m**2, true.vertical_m**2])
    return np.asarray(true.scale**2 * claimed_m2 + floor)


def innovation_covariance(claimed_m2: Floats, slope: Floats, scene: Scene, rules: Rules) -> Floats:
    """S (n, 3, 3) as the judge makes it, of fixes with claimed covariances (n, 3, 3) on slopes (n, 2)."""
    n = len(claimed_m2)
    pose = np.broadcast_to(np.eye(2) * scene.pose_sigma_m**2, (n, 2, 2))
    height = np.full(n, scene.map_sigma_m**2 + ASSUMPTIONS.antenna_sigma_m**2)
    return difference_covariance(inflated_covariance(claimed_m2, rules), pose, height, slope)
