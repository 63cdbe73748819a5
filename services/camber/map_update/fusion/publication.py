"""What becomes of each surface's height: published, withdrawn, held for review, or nothing; and alarms of regions.

A correction is the offset of a surface against the reference. A change is what the votes say beyond the correction
that the map has now. It is published when it is

* **significant**: |change| − 3.3 standard errors > 3 cm, in the Student sense: the errors' degrees of freedom count;
* **not one of many**: its p-value for "|change| ≤ 3 cm" passes Benjamini & Hochberg's procedure (1995) over all the
  surfaces looked at. It bounds the share of false ones among the published, also for p-values that depend positively
  on one another (Benjamini & Yekutieli 2001), as those of neighbours do: they share vehicles. Bonferroni would bound
  the chance of a single false one, and publish later the larger a region is; and since nearly all roads are well
  within 3 cm, with p-values near 1 and not uniform, the share found is far below the bound anyhow;
* **nobody's alone**: it is significant also without those who speak for it most, a fifth of the vehicles of the last
  three weeks. What is left then is no more than what the others say, so no fifth brings one about, whatever they say;
* **agreed**: more than 0.6 of the vehicles are within three spreads of it;
* **seen** on at least two days, by at least five vehicles whose bias is known from other streets;
* **continuous**: a neighbour is moved by half as much or more, or none is known well enough to say it did not. A bump
  of one surface that no neighbour shares is held;
* **not of a region's common shift**: where most of a region's surfaces moved alike it is a base station, a datum, a
  survey or a new kind of vehicle that is off. That is one alarm, and whatever would be published there is held.

A change back into the reference's 3 cm withdraws the correction. All others stay.

σ of a height that is published, withdrawn, or confirmed by many is √(change left² + standard error² + shape²): what is
now known of its error, with what one offset for the whole surface leaves. It does not fall below a centimetre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.map_update.fusion.biweight import Heights
from camber.map_update.fusion.surface_neighbours import Surroundings
from camber.map_update.fusion.votes import Floats, Integers

DecisionWord = Literal["nothing", "publish", "withdraw", "hold"]
DECISIONS: tuple[DecisionWord, ...] = get_args(DecisionWord)
ReasonWord = Literal[
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
REASONS: tuple[ReasonWord, ...] = get_args(ReasonWord)

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
        ("p_value", "<f8"),
        ("agreement", "<f8"),
        ("vehicles", "<i8"),
        ("known_vehicles", "<i8"),
        ("votes", "<i8"),
        ("days", "<i8"),
        ("first_session", "<i8"),
        ("last_session", "<i8"),
        ("region", "<i8"),
    ]
)
"""One surface. `decision` and `reason` index DECISIONS and REASONS. `offset_m` is what the votes say against the
reference, `correction_m` what the map is to have from now on, `sigma_m` its σ, NaN where it stays as it is."""

ALARM = np.dtype(
    [
        ("region", "<i8"),
        ("latitude_rad", "<f8"),
        ("longitude_rad", "<f8"),
        ("shift_m", "<f8"),
        ("standard_error_m", "<f8"),
        ("share", "<f8"),
        ("surfaces", "<i8"),
    ]
)
"""One region whose surfaces moved alike: by how much, which share of how many; `region` −1: all there are."""


@dataclass(frozen=True, slots=True)
class PublicationRules:
    """When a change is published."""

    threshold_m: float = 0.03
    """A change of less is not worth a new tile, nor told from what a lane's crossfall does."""
    standard_errors: float = 3.3
    """One false in two thousand at the threshold itself."""
    false_discovery_rate: float = 0.01
    """Bound of the share of false ones among the published."""
    least_agreement: float = 0.6
    least_vehicles: int = 5
    least_days: int = 2
    largest_m: float = 0.5
    """A larger change is another road than the one surveyed: a person has to look."""
    step_share: float = 0.5
    """A neighbour shares a change if it stays behind it by at most this share of it."""
    least_sigma_m: float = 0.01
    confirming_vehicles: int = 20
    """So many confirm a height that was not touched."""
    region_shift_m: float = 0.01
    region_share: float = 0.6
    """Of a region's surfaces, so many move alike by more than region_shift_m: alarm."""
    region_surfaces: int = 30
    region_links: int = 5
    """A region of fewer surfaces or links is too small for a shift of its own: it may be one road."""
    few_standard_errors: float = 1.65
    """How significant a change must be without those who speak for it most."""


@dataclass(frozen=True, slots=True, eq=False)
class Decisions:
    """Rows of DECISION (n,), in ascending order of surface ids, one for each surface with votes; and of ALARM."""

    surfaces: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, DECISION))
    alarms: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, ALARM))

    def of(self, word: DecisionWord) -> NDArray[np.void]:
        """The surfaces of which this was decided."""
        chosen: NDArray[np.void] = self.surfaces[self.surfaces["decision"] == DECISIONS.index(word)]
        return chosen


def decided(
    row: Integers,
    heights: Heights,
    common_error_m: Floats,
    shape_m: Floats,
    correction_m: Floats,
    surroundings: Surroundings,
    rules: PublicationRules,
) -> Decisions:
    """Decide of surfaces (n,), in ascending rows `row` of the surroundings.

    `common_error_m` is what the biases of all their vehicles together leave open, `shape_m` how much the road's offset
    varies within each surface, `correction_m` what the map has now.
    """
    surfaces = np.zeros(len(row), DECISION)
    error_m = np.hypot(heights.standard_error_m, common_error_m)
    change_m = heights.location_m - correction_m
    surfaces["surface_id"] = surroundings.surface_id[row]
    surfaces["offset_m"], surfaces["standard_error_m"] = heights.location_m, error_m
    surfaces["previous_correction_m"] = surfaces["correction_m"] = correction_m
    surfaces["agreement"] = heights.agreement
    surfaces["vehicles"], surfaces["known_vehicles"] = heights.voters, heights.known_voters
    surfaces["votes"], surfaces["days"] = heights.votes, heights.days
    surfaces["first_session"], surfaces["last_session"] = heights.first_session, heights.last_session
    surfaces["region"] = surroundings.region[row]
    looked_at = heights.voters > 0
    without_few_m = np.where(
        change_m > 0.0,
        heights.without_highest_m - correction_m,
        correction_m - heights.without_lowest_m,
    )
    z, few = (
        normal_deviates((size_m - rules.threshold_m) / error_m, heights.degrees)
        for size_m in (np.abs(change_m), without_few_m)
    )
    z[~looked_at] = -np.inf
    surfaces["p_value"] = p_value = upper_tails(z)
    discovered = benjamini_hochberg(p_value, rules.false_discovery_rate, int(np.count_nonzero(looked_at)))

    enough = (heights.voters >= rules.least_vehicles) & (heights.days >= rules.least_days)
    alarms, shifted = _regional_shifts(row, change_m, common_error_m, enough, surroundings, rules)
    stepped = _stands_alone(row, heights.location_m, change_m, error_m, enough, surroundings, rules)
    returned = (correction_m != 0.0) & (
        np.abs(heights.location_m) - rules.standard_errors * error_m <= rules.threshold_m
    )
    # The first that is true decides.
    cases: tuple[tuple[NDArray[np.bool_], DecisionWord, ReasonWord], ...] = (
        (heights.voters < rules.least_vehicles, "nothing", "too_few_vehicles"),
        (heights.days < rules.least_days, "nothing", "too_few_days"),
        (~(np.abs(change_m) > rules.threshold_m), "nothing", "within_threshold"),
        (z < rules.standard_errors, "nothing", "not_significant"),
        (~discovered, "nothing", "false_discovery"),
        (~(few >= rules.few_standard_errors), "nothing", "rests_on_few"),
        (heights.known_voters < rules.least_vehicles, "hold", "vehicles_not_known"),
        (~(heights.agreement > rules.least_agreement), "hold", "disagreed"),
        (np.abs(change_m) > rules.largest_m, "hold", "too_large"),
        (shifted, "hold", "regional_shift"),
        (stepped, "hold", "step"),
        (returned, "withdraw", "changed_back"),
        (np.ones(len(row), bool), "publish", "changed"),
    )
    when = [case for case, _, _ in cases]
    surfaces["decision"] = np.select(when, [DECISIONS.index(word) for _, word, _ in cases])
    surfaces["reason"] = np.select(when, [REASONS.index(word) for _, _, word in cases])

    publishes = surfaces["decision"] == DECISIONS.index("publish")
    withdraws = surfaces["decision"] == DECISIONS.index("withdraw")
    confirmed = (surfaces["decision"] == DECISIONS.index("nothing")) & enough
    confirmed &= (heights.known_voters >= rules.confirming_vehicles) & ~shifted
    confirmed &= heights.agreement > rules.least_agreement
    surfaces["correction_m"][publishes] = heights.location_m[publishes]
    surfaces["correction_m"][withdraws] = 0.0
    left_m = np.sqrt((heights.location_m - surfaces["correction_m"]) ** 2 + error_m**2 + shape_m**2)
    surfaces["sigma_m"] = np.where(
        publishes | withdraws | confirmed, np.maximum(left_m, rules.least_sigma_m), np.nan
    )
    return Decisions(surfaces, alarms)


def benjamini_hochberg(p_value: Floats, rate: float, looked_at: int) -> NDArray[np.bool_]:
    """Which of p-values (n,) are discoveries at a false-discovery rate, in a family of `looked_at` (their eq. 1)."""
    order = np.argsort(p_value, kind="stable")
    passes = p_value[order] <= rate * np.arange(1, len(p_value) + 1) / max(looked_at, 1)
    found = np.zeros(len(p_value), bool)
    if passes.any():
        found[order[: int(np.flatnonzero(passes)[-1]) + 1]] = True
    return found


@compiled
def normal_deviates(t: Floats, degrees: Floats) -> Floats:
    """Normal deviates (n,) of the same tail as Student's t (n,), to 0.2 % from 3 degrees on (Wallace 1959, eq. 1)."""
    z = np.empty(len(t))
    for i in range(len(t)):
        v = degrees[i]
        size = (8.0 * v + 1.0) / (8.0 * v + 3.0) * math.sqrt(v * math.log1p(t[i] * t[i] / v))
        z[i] = math.copysign(size, t[i])
    return z


@compiled
def upper_tails(z: Floats) -> Floats:
    """Probabilities (n,) that a normal deviate exceeds each of z."""
    p = np.empty(len(z))
    for i in range(len(z)):
        p[i] = 0.5 * math.erfc(z[i] / math.sqrt(2.0))
    return p


def _stands_alone(
    row: Integers,
    offset_m: Floats,
    change_m: Floats,
    error_m: Floats,
    enough: NDArray[np.bool_],
    surroundings: Surroundings,
    rules: PublicationRules,
) -> NDArray[np.bool_]:
    """Surfaces (n,) that moved while no neighbour did, of those that enough vehicles have seen."""
    total = len(surroundings.surface_id)
    of_all_m, error_of_all_m = np.full(total, np.nan), np.full(total, np.nan)
    of_all_m[row[enough]], error_of_all_m[row[enough]] = offset_m[enough], error_m[enough]
    return _alone(
        row,
        change_m,
        error_m,
        offset_m,
        of_all_m,
        error_of_all_m,
        surroundings.neighbour_begins,
        surroundings.neighbour,
        rules.step_share,
        rules.standard_errors,
    )


@compiled
def _alone(
    row: Integers,
    change_m: Floats,
    error_m: Floats,
    offset_m: Floats,
    of_all_m: Floats,
    error_of_all_m: Floats,
    begins: Integers,
    neighbour: Integers,
    share: float,
    standard_errors: float,
) -> NDArray[np.bool_]:
    alone = np.zeros(len(row), np.bool_)
    for i in range(len(row)):
        known = 0
        for k in range(begins[row[i]], begins[row[i] + 1]):
            other_m, other_error_m = of_all_m[neighbour[k]], error_of_all_m[neighbour[k]]
            if np.isnan(other_m):
                continue
            known += 1
            behind_m = (offset_m[i] - other_m) * math.copysign(1.0, change_m[i])
            unsure_m = standard_errors * math.sqrt(other_error_m**2 + error_m[i] ** 2)
            if behind_m <= max(share * abs(change_m[i]), unsure_m):
                known = -1
                break
        alone[i] = known > 0
    return alone


def _regional_shifts(
    row: Integers,
    change_m: Floats,
    common_error_m: Floats,
    enough: NDArray[np.bool_],
    surroundings: Surroundings,
    rules: PublicationRules,
) -> tuple[NDArray[np.void], NDArray[np.bool_]]:
    """Alarms, and which surfaces (n,) are of a region that has one; of each region, then of all together."""
    region = surroundings.region[row]
    latitude_rad, longitude_rad = surroundings.region_latitude_rad, surroundings.region_longitude_rad
    places = [(int(k), region == k, latitude_rad[k], longitude_rad[k]) for k in np.unique(region[enough])]
    if places:
        whole = np.ones(len(row), bool)
        places.append((-1, whole, float(np.mean(latitude_rad)), float(np.mean(longitude_rad))))
    alarms, shifted = [], np.zeros(len(row), bool)
    for number, inside, *middle in places:
        of = np.flatnonzero(inside & enough)
        links = len(np.unique(surroundings.link_id[row[of]]))
        if len(of) < rules.region_surfaces or links < rules.region_links:
            continue
        shift_m = float(np.median(change_m[of]))
        spread_m = 1.4826 * float(np.median(np.abs(change_m[of] - shift_m)))
        # Surfaces of one link are not independent of one another: of 1.2533 σ / √n of a median, n is that of links.
        error_m = math.hypot(1.2533 * spread_m / math.sqrt(links), float(np.median(common_error_m[of])))
        alike = np.abs(change_m[of] - shift_m) < np.abs(change_m[of])
        if (
            abs(shift_m) - rules.standard_errors * error_m > rules.region_shift_m
            and alike.mean() > rules.region_share
        ):
            alarms.append((number, *middle, shift_m, error_m, alike.mean(), len(of)))
            shifted |= inside
    return np.array(alarms, ALARM), shifted
