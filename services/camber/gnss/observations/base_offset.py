"""Offset of a base station's coordinate, from its receiver's own single points over minutes and days.

Within minutes the error of a single point hardly averages: errors of the broadcast ionosphere, orbits and clocks last
for hours. P. Misra, P. Enge, "Global positioning system", 5.3: the ranging error without multipath and noise changes
over tens of minutes to hours. In the recordings at hand of 5 and 6 minutes at 1 Hz the horizontal scatter is 0.1 to
0.3 m and the mean error 0.5 and 1.4 m. So the covariance of a mean over a window is that of one epoch, C; the mean only
removes what single epochs do wrong. It lowers the detectable offset all the same: a single epoch needs a least distance
against outliers, a mean of minutes does not.

Windows of different days have different satellites' errors and another ionosphere. Over D of them the covariance is
S² + C / D with a floor S² of what is the same every day: the model's ionosphere at the same hour, reflections at the
base, and the frame. A mean m is tested with χ² = mᵀ (…)⁻¹ m, three degrees of freedom.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camber.formats.observations import Floats
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.observations.satellite_states import enu_from_ecef_rotation, geodetic

Vector = tuple[float, float, float]
"""East, north, up in metres."""
LARGEST_CHI2 = 36.0
"""Derived: three degrees of freedom, 1e-7 by chance."""
DAILY_FLOOR_M: Vector = (0.5, 0.5, 1.5)
"""σ of the part of a day's mean that is the same every day; chosen: half the horizontal mean errors of the recordings,
upwards as the ionosphere, whose error is three times as large there."""
_SAMPLES = 60  # chosen: ten minutes of one each ten seconds
_LEAST_SAMPLES = 6  # chosen: a minute; scatter of 0.3 m is then far below the mean's error


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseOffset:
    """Single point less coordinate, east, north, up, and its σ by axis; `windows`: independent days that it rests on.

    `chi2` is the test statistic with the full covariance.
    """

    enu_m: Vector
    sigma_m: Vector
    chi2: float
    windows: int = 1

    @property
    def is_wrong(self) -> bool:
        """Whether the coordinate contradicts the single points."""
        return self.chi2 > LARGEST_CHI2

    def coordinate_error(self) -> str:
        """The coordinate less the single points, for an operator."""
        over = "minutes" if self.windows == 1 else f"{self.windows} days"
        east, north, up = (-value for value in self.enu_m)
        return f"{as_text((east, north, up))} from its single points over {over}"


class OffsetWindow:
    """Mean offset over the newest samples, of which there should be one each ten seconds."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, Floats, Floats]] = deque(maxlen=_SAMPLES)

    def clear(self) -> None:
        """Forget the samples: the coordinate or the clock has changed."""
        self._samples.clear()

    def add(self, time_ns: int, miss_ecef_m: Floats, covariance_ecef_m2: Floats) -> None:
        """Add a single point less the coordinate (3,), with its covariance (3, 3), if ten seconds after the last."""
        if self._samples and time_ns - self._samples[-1][0] < 10 * NS_PER_SECOND:
            return
        self._samples.append((time_ns, miss_ecef_m, covariance_ecef_m2))

    def offset(self, position_ecef_m: Floats) -> BaseOffset | None:
        """The mean about the coordinate (3,), None before a minute of samples."""
        if len(self._samples) < _LEAST_SAMPLES:
            return None
        rotation = enu_rotation(position_ecef_m)
        mean_m = rotation @ np.mean([miss_m for _, miss_m, _ in self._samples], axis=0)
        covariance_m2 = rotation @ np.mean([c for *_, c in self._samples], axis=0) @ rotation.T
        return BaseOffset(
            enu_m=_vector(mean_m),
            sigma_m=_vector(np.sqrt(np.diag(covariance_m2))),
            chi2=float(mean_m @ np.linalg.solve(covariance_m2, mean_m)),
        )


def offset_over_days(days: Sequence[tuple[Vector, Vector]]) -> BaseOffset | None:
    """The mean of the offsets of different days, each with its σ by axis; None for fewer than two."""
    if len(days) < 2:
        return None
    offsets, sigmas = np.array([enu_m for enu_m, _ in days]), np.array([sigma_m for _, sigma_m in days])
    mean_m = offsets.mean(axis=0)
    variance_m2 = np.array(DAILY_FLOOR_M) ** 2 + (sigmas**2).mean(axis=0) / len(days)
    return BaseOffset(
        enu_m=_vector(mean_m),
        sigma_m=_vector(np.sqrt(variance_m2)),
        chi2=float((mean_m**2 / variance_m2).sum()),
        windows=len(days),
    )


def enu_rotation(position_ecef_m: Floats) -> Floats:
    """Rotation (3, 3) from ECEF to east, north, up at a place (3,)."""
    latitude, longitude, _ = geodetic(position_ecef_m)
    rotation: Floats = enu_from_ecef_rotation(latitude, longitude)
    return rotation


def as_text(enu_m: Vector) -> str:
    """East, north, up in words."""
    east, north, up = (round(value, 2) + 0.0 for value in enu_m)  # no −0.00
    return f"{east:+.2f} m east, {north:+.2f} m north, {up:+.2f} m up"


def _vector(values: Floats) -> Vector:
    return float(values[0]), float(values[1]), float(values[2])
