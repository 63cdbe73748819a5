"""Made-up roads for the relief's estimators: a plan that turns, a height that rises and falls, and a crossfall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief.terrain import TerrainHeights
from camber.localizer.relief.terrain_contour_matching import HeightWindow

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Hills:
    """A height field of waves: amplitudes (m) at wave numbers (w, 2) in rad/m and phases."""

    amplitude_m: Floats
    wave: Floats
    phase: Floats
    grade: tuple[float, float] = (0.0, 0.0)

    def at(self, east_m: Floats, north_m: Floats) -> TerrainHeights:
        angle = east_m[..., None] * self.wave[:, 0] + north_m[..., None] * self.wave[:, 1] + self.phase
        slopes = -self.amplitude_m * np.sin(angle)
        return TerrainHeights(
            (self.amplitude_m * np.cos(angle)).sum(-1) + self.grade[0] * east_m + self.grade[1] * north_m,
            (slopes * self.wave[:, 0]).sum(-1) + self.grade[0],
            (slopes * self.wave[:, 1]).sum(-1) + self.grade[1],
        )


def hills(seed: int, slope_rms: float = 0.016) -> Hills:
    """Waves of 80 to 800 m in all directions, of this slope."""
    rng = np.random.default_rng(seed)
    length, yaw = np.geomspace(80.0, 800.0, 24), rng.uniform(0.0, 2.0 * np.pi, 24)
    wave = 2.0 * np.pi / length[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
    # The slope along one direction is half the sum of (amplitude x wave number)^2 over all, times cos^2.
    amplitude = slope_rms * np.sqrt(4.0 / len(length)) / np.hypot(*wave.T)
    return Hills(amplitude_m=amplitude, wave=wave, phase=rng.uniform(0.0, 2.0 * np.pi, 24))


def flat(grade: tuple[float, float] = (0.0, 0.0)) -> Hills:
    """A plane."""
    return Hills(amplitude_m=np.zeros(1), wave=np.ones((1, 2)), phase=np.zeros(1), grade=grade)


def drive(
    field: Hills,
    model: HeightErrorModel,
    *,
    shift_m: tuple[float, float],
    seed: int,
    length_m: float = 1000.0,
    map_sigma_m: float = 0.02,
    fix_sigma_m: float = 0.01,
) -> HeightWindow:
    """Heights every 10 m at 10 m/s on a road that turns by a quarter in its middle, with errors drawn from the model;
    the track is off, so that the true place is `shift_m` from it."""
    rng = np.random.default_rng(seed)
    path = np.arange(0.0, length_m, 10.0)
    heading = 0.5 * np.pi / (1.0 + np.exp(-(path - 0.5 * length_m) / 40.0))
    east, north = 10.0 * np.cumsum(np.cos(heading)), 10.0 * np.cumsum(np.sin(heading))
    count = len(path)
    sigma, fix_sigma = np.full(count, map_sigma_m), np.full(count, fix_sigma_m)
    places = np.column_stack([east, north])
    errors = model.covariance(places, 0.1 * path, map_sigma_m=sigma, fix_sigma_m=fix_sigma)
    noise = np.linalg.cholesky(errors) @ rng.standard_normal(count) + 1.8
    height = field.at(east + shift_m[0], north + shift_m[1]).elevation_m + noise
    return HeightWindow(
        time_s=0.1 * path,
        east_m=east,
        north_m=north,
        height_m=height,
        sigma_m=fix_sigma,
        map_sigma_m=sigma,
    )
