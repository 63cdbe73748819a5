"""The Kalman update of a few rows."""

from __future__ import annotations

import numpy as np

from camber.localizer.arrays import Floats


def kalman_update(
    x: Floats, p: Floats, *, h: Floats, innovation: Floats, noise: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return state (n,), covariance (n, n) and innovation covariance (m, m) after an observation.

    The observation has m = 1 or 2 rows `h` (m, n) with `noise` (m, m); their sum of covariances must be regular.
    """
    ph = p @ h.T
    s = h @ ph + noise
    gain = ph / s[0, 0] if len(s) == 1 else ph @ inverse_2x2(s)
    updated = p - gain @ ph.T
    return x + gain @ innovation, 0.5 * (updated + updated.T), s


def inverse_2x2(s: Floats) -> Floats:
    """Return the inverse of a regular matrix (2, 2)."""
    a, b, c, d = float(s[0, 0]), float(s[0, 1]), float(s[1, 0]), float(s[1, 1])
    scale = 1.0 / (a * d - b * c)
    return np.array(((d * scale, -b * scale), (-c * scale, a * scale)))
