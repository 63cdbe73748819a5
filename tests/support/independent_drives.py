"""Fixes against an independent position whose errors go on as real ones do and have the covariance that it reports."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from camber.integrity.learning.residuals import FixResidual
from support.residual_drives import EARTH_M, KEY, START_NS

Floats = NDArray[np.float64]
Errors = Literal["steady", "constant", "scale", "random_walk", "corrected", "several"]
ERRORS: tuple[Errors, ...] = get_args(Errors)
FIX_SIGMA_M = 0.02


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A straight drive north-east or in whatever direction; `sigma_m` is the scale of the independent errors."""

    seconds: float
    errors: Errors = "steady"
    sigma_m: float = 0.5
    speed_m_s: float = 15.0
    heading_rad: float = 0.6
    rate_hz: float = 1.0


def independent_errors(drive: Drive, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Errors along and across (n, 2) and their variances (n, 2)."""
    n = int(drive.seconds * drive.rate_hz)
    step_m = drive.speed_m_s / drive.rate_hz
    way_m = step_m * np.arange(n)
    sigma_m = drive.sigma_m
    errors, variances = np.zeros((n, 2)), np.zeros((n, 2))
    for axis in range(2):
        normal = rng.standard_normal(n)
        match drive.errors:
            case "steady":  # first-order Gauss-Markov, renewed over 300 m
                memory = np.exp(-step_m / 300.0)
                error, values = normal[0], [normal[0]]
                for one in normal[1:]:
                    error = memory * error + np.sqrt(1.0 - memory**2) * one
                    values.append(error)
                errors[:, axis], variances[:, axis] = sigma_m * np.array(values), sigma_m**2
            case "several":  # of 40 m, 300 m and 2 km at once
                for share, length_m in ((0.1, 40.0), (0.7, 300.0), (0.2, 2000.0)):
                    memory = np.exp(-step_m / length_m)
                    error, values = rng.standard_normal(), []
                    for one in rng.standard_normal(n):
                        error = memory * error + np.sqrt(1.0 - memory**2) * one
                        values.append(error)
                    errors[:, axis] += sigma_m * np.sqrt(share) * np.array(values)
                variances[:, axis] = sigma_m**2
            case "constant":
                errors[:, axis], variances[:, axis] = sigma_m * normal[0], sigma_m**2
            case "scale":  # one percent of the way, after a start of 0.3 m
                errors[:, axis] = 0.3 * normal[0] + 0.01 * way_m * normal[1]
                variances[:, axis] = 0.3**2 + (0.01 * way_m) ** 2
            case "random_walk":  # 0.5 m after 100 m
                errors[:, axis] = 0.3 * normal[0] + np.cumsum(np.sqrt(0.0025 * step_m) * normal)
                variances[:, axis] = 0.3**2 + 0.0025 * way_m
            case "corrected":  # a random walk with an observation of position each kilometre
                error, variance = 0.3 * normal[0], 0.3**2
                for k in range(n):
                    error += np.sqrt(0.0025 * step_m) * normal[k]
                    variance += 0.0025 * step_m
                    if k % int(1000.0 / step_m) == 0 and k:
                        gain = variance / (variance + sigma_m**2)
                        error += gain * (sigma_m * rng.standard_normal() - error)
                        variance *= 1.0 - gain
                    errors[k, axis], variances[k, axis] = error, variance
    return errors, variances


def _evidence_ns(drive: Drive, k: int) -> int:
    """Of the last evidence at an epoch: always new where errors are steady, each kilometre where they are corrected."""
    step_m = drive.speed_m_s / drive.rate_hz
    last = {"steady": k, "several": k - k % 20, "corrected": k - k % int(1000.0 / step_m)}.get(
        drive.errors, 0
    )
    return START_NS + round(last / drive.rate_hz * 1e9)


def residuals(drive: Drive, seed: int, fault_m: Floats | None = None) -> Iterator[FixResidual]:
    """Residuals of fixes that are off by `fault_m` (n, 2), along and across the way; heights are not known."""
    rng = np.random.default_rng(seed)
    errors, variances = independent_errors(drive, rng)
    n = len(errors)
    off_m = -errors + rng.normal(0.0, FIX_SIGMA_M, (n, 2)) + (0.0 if fault_m is None else fault_m)
    cos, sin = np.cos(drive.heading_rad), np.sin(drive.heading_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    off_m = off_m @ turn.T
    covariances = np.einsum("ij,nj,kj->nik", turn, variances, turn)
    for k in range(n):
        (ee, en), (_, nn) = covariances[k].tolist()
        yield FixResidual(
            time_ns=START_NS + round(k / drive.rate_hz * 1e9),
            verdict="unknown",
            latitude_rad=0.6 + drive.speed_m_s * k / drive.rate_hz / EARTH_M,
            longitude_rad=2.4,
            key=KEY,
            evidence_ns=_evidence_ns(drive, k),
            independent=(float(off_m[k, 0]), float(off_m[k, 1]), ee, en, nn, FIX_SIGMA_M),
        )
