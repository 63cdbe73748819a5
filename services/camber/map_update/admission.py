"""What the store takes in: beyond the schema, an observation must be possible and its datum a known one.

A refusal is for ever: the vehicle files the upload away and does not send it again. So this judges only what no later
knowledge can put right, generously; whether a possible height is *true* is the business of the fusion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt

from camber.map_update.contribution import Contribution
from camber.schemas.base import EARLIEST_NS

_LARGEST_ID = 2**62


@dataclass(frozen=True, slots=True)
class Rules:
    """Bounds of what is possible; see `settings.py` for each."""

    datums: frozenset[str]
    future_limit_s: float
    lowest_road_m: float
    highest_road_m: float
    least_sigma_m: float
    largest_sigma_m: float
    highest_antenna_m: float
    most_records: int
    oldest_s: float | None = None


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why not: a code to count by, and a line that names the field, its value and what was expected."""

    code: str
    text: str


def refusal(contribution: Contribution, now_ns: int, rules: Rules) -> Refusal | None:
    """Why `contribution` cannot be taken in at GPS time `now_ns`, or None."""
    return _heading(contribution, rules) or _observations(contribution.observations, now_ns, rules)


def refusals(contributions: Sequence[Contribution], now_ns: int, rules: Rules) -> list[Refusal | None]:
    """`refusal` of each of a group; the usual one, of which nothing is refused, is looked through as a whole."""
    rows = [contribution.observations for contribution in contributions]
    if rows and _observations(np.concatenate(rows), now_ns, rules) is None:
        return [_heading(contribution, rules) for contribution in contributions]
    return [refusal(contribution, now_ns, rules) for contribution in contributions]


def other_name(vehicle: str, contribution: Contribution) -> Refusal | None:
    """Why what came under the key of `vehicle` cannot be taken in: it speaks for another one. None: it does not."""
    if contribution.vehicle == vehicle:
        return None
    text = f"vehicle {contribution.vehicle} was uploaded under the key of {vehicle}, expected its own"
    return Refusal("vehicle", text)


def _heading(contribution: Contribution, rules: Rules) -> Refusal | None:
    records = len(contribution.observations)
    if not 1 <= records <= rules.most_records:
        return Refusal("records", f"{records} records, expected 1 to {rules.most_records}")
    if contribution.datum not in rules.datums:
        known = ", ".join(sorted(rules.datums))
        return Refusal("datum", f"datum {contribution.datum}, expected one of {known}"[:512])
    return None


def _observations(rows: npt.NDArray[np.void], now_ns: int, rules: Rules) -> Refusal | None:
    earliest_ns = EARLIEST_NS
    if rules.oldest_s is not None:
        earliest_ns = max(earliest_ns, now_ns - round(rules.oldest_s * 1e9))
    bounds: tuple[tuple[str, float, float], ...] = (
        ("time_ns", earliest_ns, now_ns + round(rules.future_limit_s * 1e9)),
        ("fix_id", 0, _LARGEST_ID),
        ("surface_id", 0, _LARGEST_ID),
        ("latitude_rad", -pi / 2, pi / 2),
        ("longitude_rad", -pi, pi),
        ("horizontal_sigma_m", 0.0, rules.largest_sigma_m),
        ("road_height_m", rules.lowest_road_m, rules.highest_road_m),
        ("road_height_sigma_m", rules.least_sigma_m, rules.largest_sigma_m),
        ("antenna_height_m", 0.0, rules.highest_antenna_m),
    )
    for field, low, high in bounds:
        values = rows[field]
        wrong = (values < low) | (values > high)
        if wrong.any():
            at = int(np.argmax(wrong))
            return Refusal(field, f"record {at}: {field} {values[at]}, expected {low} to {high}")
    nowhere = (rows["latitude_rad"] == 0.0) & (rows["longitude_rad"] == 0.0)
    if nowhere.any():
        return Refusal(
            "position", f"record {int(np.argmax(nowhere))}: latitude and longitude 0, expected a position"
        )
    return None
