"""Stanford charts: errors against protection levels and alert limits, of a drive and by source of the position."""

from __future__ import annotations

from typing import Any

import numpy as np

from camber.schemas.base import Float64
from camber.validation.fix_statistics import Flags
from camber.validation.protection_level_statistics import Positions


def stanford(positions: Positions) -> dict[str, dict[str, int]]:
    """Counts of the regions of the Stanford chart, for the 99.9 % radius, HPL and VPL.

    With protection level L, error e, alert limit A: nominal e ≤ L < A; misleading L < e, L < A; hazardous those of
    them with e > A; unavailable L ≥ A, e ≤ L; unavailable_misleading L ≥ A, e > L. VPL is compared with the vertical
    alert limit, where there is one.
    """
    return _charts(positions, np.ones(len(positions.time_ns), bool))


def levels_by_source(positions: Positions) -> dict[str, Any]:
    """By source and in total: Stanford charts of HPL and VPL, and the tightness of the protection levels.

    `ratio` is the median level over the median error; None without level or truth.
    """
    sources = sorted(set(positions.source.tolist()) - {"none"})
    result: dict[str, Any] = {}
    for source in [*sources, "all"]:
        rows = (positions.source == source) if source != "all" else np.ones(len(positions.source), bool)
        charts = _charts(positions, rows)
        result[source] = {
            "hpl": charts["hpl"] | _tightness(positions.hpl_m[rows], positions.horizontal_error_m[rows]),
            "vpl": charts["vpl"] | _tightness(positions.vpl_m[rows], np.abs(positions.error_enu_m[rows, 2])),
        }
    return result


def _tightness(level_m: Float64, error_m: Float64) -> dict[str, float | None]:
    both = np.isfinite(level_m) & np.isfinite(error_m)
    if not both.any():
        return {"median_level_m": None, "median_error_m": None, "ratio": None}
    level, error = float(np.median(level_m[both])), float(np.median(error_m[both]))
    ratio = level / error if error > 0.0 else None
    return {"median_level_m": level, "median_error_m": error, "ratio": ratio}


def _charts(positions: Positions, rows: Flags) -> dict[str, dict[str, int]]:
    horizontal, vertical = positions.horizontal_error_m, np.abs(positions.error_enu_m[:, 2])
    limit = positions.alert_limit_m
    vertical_limit = positions.vertical_alert_limit_m
    vertical_limit = np.where(np.isnan(vertical_limit), limit, vertical_limit)
    levels = {
        "radius_999": (positions.semi_major_999_m, horizontal, limit),
        "hpl": (positions.hpl_m, horizontal, limit),
        "vpl": (positions.vpl_m, vertical, vertical_limit),
    }
    return {name: _regions(*(column[rows] for column in columns)) for name, columns in levels.items()}


def _regions(level_m: Float64, error_m: Float64, limit_m: Float64) -> dict[str, int]:
    known = np.isfinite(level_m) & np.isfinite(error_m) & np.isfinite(limit_m)
    usable, held = level_m < limit_m, error_m <= level_m

    def count(flags: Flags) -> int:
        return int((known & flags).sum())

    return {
        "epochs": int(known.sum()),
        "nominal": count(usable & held),
        "misleading": count(usable & ~held),
        "hazardous": count(usable & ~held & (error_m > limit_m)),
        "unavailable": count(~usable & held),
        "unavailable_misleading": count(~usable & ~held),
    }
