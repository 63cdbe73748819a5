"""Decision on each surface's height: publish, withdraw, hold for review, or nothing; alarms for regions.

A correction is the offset of a surface from the reference. A change is the difference between the offset that the votes
give and the correction in the map now. A change is published when it is

* **significant**: |change| − 3.3 standard errors > 3 cm, with Student's t for the degrees of freedom of the errors;
* **not a false discovery**: its p-value for "|change| ≤ 3 cm" passes the procedure of Benjamini & Hochberg (1995) over
  all surfaces considered. It bounds the share of false changes among the published, also for positively dependent
  p-values (Benjamini & Yekutieli 2001) such as those of neighbours, which share vehicles;
* **not supported by few only**: significant also without the fifth of the vehicles of the last three weeks that
  supports it most, so that no fifth of the vehicles can bring about a change;
* **agreed**: more than 0.6 of the vehicles are within three spreads of it;
* **observed** on at least two days, by at least five vehicles whose bias is known from other streets;
* **continuous**: a neighbour changed by at least half as much, or no neighbour is known well enough to contradict;
* **not a common shift of a region**: where most surfaces of a region moved alike, a base station, a datum, a survey or
  a new kind of vehicle is the cause. One alarm is raised and all changes of the region are held.

A change back to within 3 cm of the reference withdraws the correction. All other corrections stay.

σ of a height that is published, withdrawn, or confirmed by many is √(remaining change² + standard error² + shape²),
at least 1 cm: the shape term covers what one offset for the whole surface leaves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from camber.compiled.decorator import compiled
from camber.map_update.fusion.robust_surface_heights import MAD_TO_SIGMA, FusedHeights
from camber.map_update.fusion.surface_neighbours import SurfaceNeighbourhood
from camber.map_update.fusion.votes import Floats, Integers

Decision = Literal["nothing", "publish", "withdraw", "hold"]
DECISIONS: tuple[Decision, ...] = get_args(Decision)
DecisionReason = Literal[
    "within_threshold",
    "not_significant",
    "false_discovery",
    "too_few_vehicles",
    "too_few_days",
    "rests_on_few",
    "changed",
    "changed_back",
    "vehicles_not_known",
    "disagreed",
    "too_large",
    "regional_shift",
    "step",
]
REASONS: tuple[DecisionReason, ...] = get_args(DecisionReason)
PENDING_REASONS: tuple[DecisionReason, ...] = (
    "not_significant", "false_discovery", "too_few_vehicles", "too_few_days", "rests_on_few",
)  # fmt: skip
"""Of changes that more votes may publish."""

DECISION = np.dtype(
    [
        ("surface_id", "<i8"),
        ("decision", "|u1"),
        ("reason", "|u1"),
        ("offset_m", "<f8"),
        ("standard_error_m", "<f8"),
        ("previous_correction_m", "<f8"),
        ("correction_m", "<f8"),
        ("sigma_m", "<f8"),
        ("agreement", "<f8"),
        ("vehicles", "<i8"),
        ("known_vehicles", "<i8"),
        ("votes", "<i8"),
        ("days", "<i8"),
        ("last_session", "<i8"),
    ]
)
"""One surface. `decision` and `reason` index DECISIONS and REASONS. `offset_m` is the votes' offset from the reference,
`correction_m` the correction of the map from now on, `sigma_m` its σ, NaN where it does not change."""

ALARM = np.dtype([("region", "<i8"), ("shift_m", "<f8"), ("share", "<f8"), ("surfaces", "<i8")])
"""One region whose surfaces moved alike: by how much, which share of how many; `region` −1: all surfaces together."""

# Chosen on the fleet scenario, seeds 1, 2 and 4 (docs/fusion.md).
_LEAST_AGREEMENT = 0.6
_STEP_SHARE = 0.5
"""A neighbour confirms a change if it lags by at most this share of it."""
_LEAST_SIGMA_M = 0.01
"""Floor of a published σ."""
_CONFIRMING_VEHICLES = 20
"""Known vehicles that confirm a height that did not change."""
_REGION_SHIFT_M = 0.01
_REGION_SHARE = 0.6
"""An alarm is raised when more than this share of a region's surfaces moved alike by more than _REGION_SHIFT_M."""
_REGION_SURFACES = 30
_REGION_LINKS = 5
"""A region with fewer surfaces or links may be a single road and has no common shift."""
_STANDARD_ERRORS_WITHOUT_FEW = 1.65
"""Significance of a change without the vehicles that support it most: 95 % one-sided."""
_MEDIAN_ERROR = 1.2533
"""Standard error of a median over that of a mean, for normal errors: √(π / 2)."""


class PublicationSettings(BaseModel):
    """When a change is published."""

    publish_threshold_m: float = Field(0.03, gt=0.0, le=1.0, description="smaller changes are not published")
    publish_standard_errors: float = Field(
        3.3, ge=2.0, le=10.0, description="standard errors by which a change exceeds the threshold"
    )
    publish_vehicles: int = Field(5, ge=2, description="least vehicles that observed a change")
    publish_days: int = Field(2, ge=1, le=56, description="least days on which it was observed")
    publish_largest_m: float = Field(0.5, gt=0.0, le=10.0, description="larger changes are held for review")
    false_discovery_rate: float = Field(
        0.01, gt=0.0, le=0.2, description="bound of the share of false changes among the published"
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Decisions:
    """Rows of DECISION (n,), sorted by surface id, one for each surface with votes; and rows of ALARM."""

    surfaces: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, DECISION))
    alarms: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, ALARM))
    threshold_m: float = 0.0
    """Changes up to this size are not published."""

    def pending(self) -> NDArray[np.void]:
        """Return the changes that more votes may publish, those of the most standard errors first."""
        rows = self.surfaces
        change_m = np.abs(rows["offset_m"] - rows["previous_correction_m"])
        reasons = [REASONS.index(reason) for reason in PENDING_REASONS]
        waits = (rows["decision"] == DECISIONS.index("nothing")) & np.isin(rows["reason"], reasons)
        waits &= (rows["votes"] > 0) & (change_m > self.threshold_m)
        ratio = change_m[waits] / np.maximum(rows["standard_error_m"][waits], _LEAST_SIGMA_M)
        pending: NDArray[np.void] = rows[waits][np.argsort(-ratio, kind="stable")]
        return pending

    def of(self, decision: Decision) -> NDArray[np.void]:
        """Return the surfaces with this decision."""
        chosen: NDArray[np.void] = self.surfaces[self.surfaces["decision"] == DECISIONS.index(decision)]
        return chosen


def decide(
    row: Integers,
    heights: FusedHeights,
    *,
    common_error_m: Floats,
    shape_m: Floats,
    correction_m: Floats,
    neighbourhood: SurfaceNeighbourhood,
    settings: PublicationSettings,
) -> Decisions:
    """Decide on surfaces (n,), given as ascending rows `row` of the neighbourhood.

    `common_error_m` is the uncertainty of the common bias of a surface's vehicles, `shape_m` the spread of the offset
    within each surface, `correction_m` the present correction.
    """
    surfaces = np.zeros(len(row), DECISION)
    error_m = np.hypot(heights.standard_error_m, common_error_m)
    change_m = heights.location_m - correction_m
    surfaces["surface_id"] = neighbourhood.surface_id[row]
    surfaces["offset_m"], surfaces["standard_error_m"] = heights.location_m, error_m
    surfaces["previous_correction_m"] = surfaces["correction_m"] = correction_m
    surfaces["vehicles"], surfaces["known_vehicles"] = heights.voters, heights.known_voters
    for name in ("agreement", "votes", "days", "last_session"):
        surfaces[name] = getattr(heights, name)
    considered = heights.voters > 0
    without_few_m = np.where(
        change_m > 0.0, heights.without_highest_m - correction_m, correction_m - heights.without_lowest_m
    )
    z, z_without_few = (
        normal_deviates((size_m - settings.publish_threshold_m) / error_m, heights.degrees)
        for size_m in (np.abs(change_m), without_few_m)
    )
    z[~considered] = -np.inf
    rate, tests = settings.false_discovery_rate, int(np.count_nonzero(considered))
    discovered = benjamini_hochberg(upper_tails(z), rate, tests)

    enough = (heights.voters >= settings.publish_vehicles) & (heights.days >= settings.publish_days)
    changes = _Changes(
        row=row, offset_m=heights.location_m, change_m=change_m, error_m=error_m, enough=enough
    )
    alarms, shifted = _regional_shifts(changes, common_error_m, neighbourhood, settings)
    isolated = _isolated_steps(
        changes, neighbourhood.neighbour_begins, neighbourhood.neighbour, settings.publish_standard_errors
    )
    returned = (correction_m != 0.0) & (
        np.abs(heights.location_m) - settings.publish_standard_errors * error_m
        <= settings.publish_threshold_m
    )
    # The first that is true decides.
    cases: tuple[tuple[NDArray[np.bool_], Decision, DecisionReason], ...] = (
        (heights.voters < settings.publish_vehicles, "nothing", "too_few_vehicles"),
        (heights.days < settings.publish_days, "nothing", "too_few_days"),
        (~(np.abs(change_m) > settings.publish_threshold_m), "nothing", "within_threshold"),
        (z < settings.publish_standard_errors, "nothing", "not_significant"),
        (~discovered, "nothing", "false_discovery"),
        (~(z_without_few >= _STANDARD_ERRORS_WITHOUT_FEW), "nothing", "rests_on_few"),
        (heights.known_voters < settings.publish_vehicles, "hold", "vehicles_not_known"),
        (~(heights.agreement > _LEAST_AGREEMENT), "hold", "disagreed"),
        (np.abs(change_m) > settings.publish_largest_m, "hold", "too_large"),
        (shifted, "hold", "regional_shift"),
        (isolated, "hold", "step"),
        (returned, "withdraw", "changed_back"),
        (np.ones(len(row), bool), "publish", "changed"),
    )
    conditions = [condition for condition, _, _ in cases]
    surfaces["decision"] = np.select(conditions, [DECISIONS.index(decision) for _, decision, _ in cases])
    surfaces["reason"] = np.select(conditions, [REASONS.index(reason) for _, _, reason in cases])

    publishes = surfaces["decision"] == DECISIONS.index("publish")
    withdraws = surfaces["decision"] == DECISIONS.index("withdraw")
    confirmed = (surfaces["decision"] == DECISIONS.index("nothing")) & enough
    confirmed &= (heights.known_voters >= _CONFIRMING_VEHICLES) & ~shifted
    confirmed &= heights.agreement > _LEAST_AGREEMENT
    surfaces["correction_m"][publishes] = heights.location_m[publishes]
    surfaces["correction_m"][withdraws] = 0.0
    remaining_m = np.sqrt((heights.location_m - surfaces["correction_m"]) ** 2 + error_m**2 + shape_m**2)
    surfaces["sigma_m"] = np.where(
        publishes | withdraws | confirmed, np.maximum(remaining_m, _LEAST_SIGMA_M), np.nan
    )
    return Decisions(surfaces=surfaces, alarms=alarms, threshold_m=settings.publish_threshold_m)


def benjamini_hochberg(p_value: Floats, rate: float, considered: int) -> NDArray[np.bool_]:
    """Return which p-values (n,) are discoveries at a false-discovery rate, among `considered` tests (eq. 1)."""
    order = np.argsort(p_value, kind="stable")
    passes = p_value[order] <= rate * np.arange(1, len(p_value) + 1) / max(considered, 1)
    discovered = np.zeros(len(p_value), bool)
    if passes.any():
        discovered[order[: int(np.flatnonzero(passes)[-1]) + 1]] = True
    return discovered


@compiled
def normal_deviates(t: Floats, degrees: Floats) -> Floats:
    """Return normal deviates (n,) of the same tail as Student's t (n,), to 0.2 % for 3 or more degrees of freedom.

    Wallace 1959, "Bounds on normal approximations to Student's and the chi-square distributions", eq. 1.
    """
    z = np.empty(len(t))
    for i in range(len(t)):
        v = degrees[i]
        size = (8.0 * v + 1.0) / (8.0 * v + 3.0) * math.sqrt(v * math.log1p(t[i] * t[i] / v))
        z[i] = math.copysign(size, t[i])
    return z


@compiled
def upper_tails(z: Floats) -> Floats:
    """Return the probabilities (n,) that a normal deviate exceeds each z."""
    p = np.empty(len(z))
    for i in range(len(z)):
        p[i] = 0.5 * math.erfc(z[i] / math.sqrt(2.0))
    return p


class _Changes(NamedTuple):
    """Surfaces (n,): row in the neighbourhood, offset, change, its error, and whether enough vehicles observed it."""

    row: Integers
    offset_m: Floats
    change_m: Floats
    error_m: Floats
    enough: NDArray[np.bool_]


@compiled
def _isolated_steps(
    changes: _Changes, begins: Integers, neighbour: Integers, standard_errors: float
) -> NDArray[np.bool_]:
    """Return which surfaces (n,) changed while no neighbour did, among those that enough vehicles observed."""
    place = np.full(len(begins) - 1, -1)
    for i in range(len(changes.row)):
        if changes.enough[i]:
            place[changes.row[i]] = i
    isolated = np.zeros(len(changes.row), np.bool_)
    for i in range(len(isolated)):
        change_m, contradicted = changes.change_m[i], False
        for k in range(begins[changes.row[i]], begins[changes.row[i] + 1]):
            other = place[neighbour[k]]
            if other < 0 or np.isnan(changes.offset_m[other]):
                continue
            lag_m = (changes.offset_m[i] - changes.offset_m[other]) * math.copysign(1.0, change_m)
            error_m = math.sqrt(changes.error_m[other] ** 2 + changes.error_m[i] ** 2)
            contradicted = not lag_m <= max(_STEP_SHARE * abs(change_m), standard_errors * error_m)
            if not contradicted:
                break
        isolated[i] = contradicted
    return isolated


def _regional_shifts(
    changes: _Changes,
    common_error_m: Floats,
    neighbourhood: SurfaceNeighbourhood,
    settings: PublicationSettings,
) -> tuple[NDArray[np.void], NDArray[np.bool_]]:
    """Return alarms, and which surfaces (n,) are in a region with one; each region, then all surfaces together."""
    row, change_m, enough = changes.row, changes.change_m, changes.enough
    region = neighbourhood.region[row]
    areas = [(int(k), region == k) for k in np.unique(region[enough])]
    alarms, shifted = [], np.zeros(len(row), bool)
    for number, inside in [*areas, (-1, np.ones(len(row), bool))]:
        rows = np.flatnonzero(inside & enough)
        links = len(np.unique(neighbourhood.link_id[row[rows]]))
        if len(rows) < _REGION_SURFACES or links < _REGION_LINKS:
            continue
        shift_m = float(np.median(change_m[rows]))
        spread_m = MAD_TO_SIGMA * float(np.median(np.abs(change_m[rows] - shift_m)))
        # Surfaces of one link are not independent: the n of the median's standard error is the number of links.
        error_m = math.hypot(
            _MEDIAN_ERROR * spread_m / math.sqrt(links), float(np.median(common_error_m[rows]))
        )
        alike = np.abs(change_m[rows] - shift_m) < np.abs(change_m[rows])
        significant = abs(shift_m) - settings.publish_standard_errors * error_m > _REGION_SHIFT_M
        if significant and alike.mean() > _REGION_SHARE:
            alarms.append((number, shift_m, alike.mean(), len(rows)))
            shifted |= inside
    return np.array(alarms, ALARM), shifted
