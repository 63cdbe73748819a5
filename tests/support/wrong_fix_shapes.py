"""How steep wrong fixes are, |height error| over horizontal error: simulated ones beside a recording's."""

from __future__ import annotations

import itertools
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ks_2samp

from camber.formats.drive.truth_csv import WRONG_M, read_truth
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.local_frame import LocalFrame
from camber.replay.truth_interpolation import interpolate_truth

Floats = NDArray[np.float64]

BINS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, np.inf)
NAGOYA_OFFSET_M = (0.055, -0.008, -0.045)
"""East, north, up: of right fixes against the reference (`tests/replay/nagoya.toml`)."""


def steepness(error_enu_m: Floats) -> Floats:
    """|up| / horizontal of errors (n, 3)."""
    share: Floats = np.abs(error_enu_m[:, 2]) / np.maximum(
        np.hypot(error_enu_m[:, 0], error_enu_m[:, 1]), 1e-9
    )
    return share


def is_wrong(error_enu_m: Floats) -> NDArray[np.bool_]:
    """Errors (n, 3) of fixes farther from the truth than a fix may be."""
    far: NDArray[np.bool_] = np.linalg.norm(error_enu_m, axis=1) > WRONG_M
    return far


class FixesAgainstTruth(NamedTuple):
    """Fixes (n,) of a recording: east, north, up off the reference (n, 3) and σ of the height as claimed, m."""

    error_m: Floats
    up_sigma_m: Floats
    speed_m_s: Floats


def nagoya_fixes() -> FixesAgainstTruth | None:
    """The fixes of the Nagoya recording; None without CAMBER_DATA."""
    root = os.environ.get("CAMBER_DATA")
    if not root:
        return None
    folder = Path(root) / "nagoya-2023-07-11"
    truth = read_truth(folder / "reference.csv", "nagoya")
    decoder = PosDecoder("rover_rtk.pos")
    solutions = [*decoder.feed((folder / "rover_rtk.pos").read_bytes()), *decoder.finish()]
    fixes = [s for s in solutions if isinstance(s, ReceiverSolution) and s.quality == SolutionQuality.FIX]
    frame = LocalFrame(float(truth.latitude_rad[0]), float(truth.longitude_rad[0]), 0.0)

    def placed(latitude_rad: Floats, longitude_rad: Floats, height_m: Floats) -> Floats:
        plane = frame.east_north_from_geodetic_array(latitude_rad, longitude_rad, height_m)
        return np.column_stack((plane, height_m))

    time_ns = np.array([s.time_ns for s in fixes], np.int64)
    at_fixes, known = interpolate_truth(truth, time_ns)
    fixed_m = placed(*np.array([(s.latitude_rad, s.longitude_rad, s.height_m) for s in fixes]).T)
    true_m = placed(at_fixes.latitude_rad, at_fixes.longitude_rad, at_fixes.height_m)
    driven_m = placed(truth.latitude_rad, truth.longitude_rad, truth.height_m)
    speed_m_s = np.hypot(*np.gradient(driven_m[:, :2], truth.time_ns / 1e9, axis=0).T)
    claims = np.array([np.sqrt(s.covariance_enu_m2[5]) if s.covariance_enu_m2 else np.nan for s in fixes])
    return FixesAgainstTruth(
        error_m=fixed_m[known] - true_m - np.array(NAGOYA_OFFSET_M),
        up_sigma_m=claims[known],
        speed_m_s=np.interp(time_ns[known], truth.time_ns, speed_m_s),
    )


def nagoya_fix_errors_m() -> Floats | None:
    """East, north, up (n, 3) of the fixes of the Nagoya recording; None without CAMBER_DATA."""
    fixes = nagoya_fixes()
    return None if fixes is None else fixes.error_m


def shares_percent(steep: Floats) -> Floats:
    """Of each bin (k,)."""
    share: Floats = 100.0 * np.histogram(steep, BINS)[0] / max(len(steep), 1)
    return share


def distance(one: Floats, other: Floats) -> float:
    """Kolmogorov and Smirnov's: the greatest difference of the two cumulative shares."""
    return float(ks_2samp(one, other).statistic)


def comparison(simulated: Floats, recorded: Floats | None) -> str:
    """The two histograms as a table, their medians and their distance."""
    columns = [("simulated", simulated)] + ([] if recorded is None else [("Nagoya", recorded)])
    lines = ["| height error / horizontal error | " + " | ".join(name for name, _ in columns) + " |"]
    lines.append("|---" * (len(columns) + 1) + "|")
    for k, (low, high) in enumerate(itertools.pairwise(BINS)):
        name = f"over {low:g}" if np.isinf(high) else f"{low:g} to {high:g}"
        lines.append(f"| {name} | " + " | ".join(f"{shares_percent(v)[k]:.0f} %" for _, v in columns) + " |")
    middle = (f"{np.median(v):.2f} ({len(v)})" if len(v) else "none" for _, v in columns)
    lines.append("| median (wrong fixes) | " + " | ".join(middle) + " |")
    if recorded is None:
        lines.append("the recording's column is skipped: CAMBER_DATA is not set")
    elif len(simulated):
        lines.append(f"Kolmogorov-Smirnov distance {distance(simulated, recorded):.2f}")
    return "\n".join(lines)
