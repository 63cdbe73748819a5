"""What the newest stretches of road differ by, if it is one vector that began with the first of them.

Pure functions of cells and rules; which fault makes such a difference is for `offset_causes` to say.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.learning.fix_track_offset import TrackFaultRules
from camber.integrity.learning.independent_offset import IndependentOffsetRules
from camber.integrity.learning.residuals import ResidualCell
from camber.road_map.map_error_model import MAP_ERRORS, MapErrorModel

_BEFORE = 3  # cells before an offset that must not have it; chosen: one alone may be noise


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseRules:
    """When a difference is large, when it is one, when it lasts, and when it is not that of one road.

    A height counts beyond `least_height_m` and `sigmas` of the mean, a horizontal one beyond `least_horizontal_m` and
    `horizontal_sigmas` of a single stretch: errors of scan matching are alike from stretch to stretch. `coherent` is
    the share of the stretches that must agree with one another. Roads are built, and surveyed, from crossing to
    crossing, and sometimes on to the next: an antenna shows on `antenna_links`, with `link_cells` on each, over
    `antenna_distance_m`.

    A common height beyond `antenna_limit_m` is no antenna's: deflated tyres, load and suspension make less than 0.3 m,
    and another mast on the same vehicle stands on a roof whose height is the same. Where it is chosen too small, an
    antenna is called a base; neither is learnt beyond the cap of 0.3 m.

    `wrong_integers_s`: a receiver of which 25 % of 8,365 fixes were wrong had episodes of up to two minutes. With
    lengths of even probability in their logarithm from 1 to 120 s, 8 % are longer than this.
    """

    cell_m: float = 20.0
    least_height_m: float = 0.1
    sigmas: float = 5.0
    least_horizontal_m: float = 0.2
    horizontal_sigmas: float = 3.0
    horizontal_sigma_limit_m: float = 0.3
    coherent: float = 0.75
    standing: float = 0.75
    least_cells: int = 4
    far_m: float = 5.0
    least_far_s: float = 8.0
    least_horizontal_s: float = 30.0
    least_s: float = 15.0
    antenna_links: int = 3
    antenna_distance_m: float = 400.0
    again_s: float = 60.0
    link_cells: int = 2
    antenna_limit_m: float = 1.0
    wrong_integers_s: float = 80.0
    independent: IndependentOffsetRules = field(default_factory=IndependentOffsetRules)
    fix_track: TrackFaultRules = field(default_factory=TrackFaultRules)
    map_errors: MapErrorModel = MAP_ERRORS


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenCell:
    """A cell, and the correction that was in force at its end, with its σ."""

    cell: ResidualCell
    correction_m: float
    correction_sigma_m: float = 0.0


def difference_of(seen: SeenCell) -> float | None:
    """Height difference, with the correction in force [m]."""
    return None if seen.cell.up_m is None else seen.cell.up_m - seen.correction_m


def is_large(cell: ResidualCell, difference_m: float, rules: CauseRules) -> bool:
    """Whether a height difference is more than errors make."""
    sigma_m = math.hypot(cell.fix_sigma_m, cell.map_sigma_m)
    return abs(difference_m) > max(rules.least_height_m, 3.0 * sigma_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class CellOffset:
    """What cells have in common; None where it is not observed. `horizontal_outcome`: the horizontal part is one."""

    up_m: float | None
    up_is_one: bool
    east_north_m: tuple[float, float] | None
    horizontal_outcome: bool


def offset_of(seen: Sequence[SeenCell], first: int, rules: CauseRules) -> CellOffset | None:
    """What the cells from `first` on differ by, against what held before; None: nothing, or not one thing.

    Most of them, the first and the newest must be nearer to it than to nothing: so the row begins where the difference
    begins, and a difference that has ended is none.
    """
    cells, before = [s.cell for s in seen[first:]], seen[max(first - _BEFORE, 0) : first]
    up_m, up_is_one = _height(cells, before[-1] if before else seen[0], rules)
    east_north_m, horizontal_outcome = _horizontal([_side(cell, cells[0].begin_ns) for cell in cells], rules)
    up_is_one = up_is_one and not _had_begun([d for s in before if (d := difference_of(s)) is not None], up_m)
    horizontal_outcome = horizontal_outcome and not _had_begun(
        [_along(s.cell, east_north_m) for s in before], 1.0
    )
    return (
        CellOffset(
            up_m=up_m, up_is_one=up_is_one, east_north_m=east_north_m, horizontal_outcome=horizontal_outcome
        )
        if up_is_one or horizontal_outcome
        else None
    )


def _had_begun(before: Sequence[float], value: float | None) -> bool:
    """Were the cells before nearer to this value than to nothing? Then it did not begin here: it grows."""
    if not before or value is None:
        return False
    middle = statistics.median(before)
    return abs(middle - value) < abs(middle)


def _along(cell: ResidualCell, east_north_m: tuple[float, float] | None) -> float:
    """How much of a horizontal difference a cell shows: 1 all of it, 0 nothing or not known."""
    if cell.horizontal_m is None or east_north_m is None:
        return 0.0
    east_m, north_m = east_north_m
    return (cell.horizontal_m[0] * east_m + cell.horizontal_m[1] * north_m) / (east_m**2 + north_m**2)


def _mean_sigma_m(cells: Sequence[ResidualCell], map_errors: MapErrorModel) -> float:
    """σ of the mean height difference of cells, whose map errors are correlated."""
    first = cells[0]
    place_m = np.array(
        [
            east_north_between(first.latitude_rad, first.longitude_rad, cell.latitude_rad, cell.longitude_rad)
            for cell in cells
        ]
    )
    map_m2 = map_errors.covariance_m2(place_m, np.array([cell.map_sigma_m for cell in cells])).mean()
    fix_m2 = statistics.fmean(cell.fix_sigma_m**2 for cell in cells) / len(cells)
    return math.sqrt(float(map_m2) + fix_m2)


def _height(cells: Sequence[ResidualCell], before: SeenCell, rules: CauseRules) -> tuple[float | None, bool]:
    """The cells' common height against the correction in force before, and whether they have one."""
    known = [(cell.up_m - before.correction_m, cell) for cell in cells if cell.up_m is not None]
    if len(known) < rules.least_cells:
        return None, False
    middle_m = statistics.median(up_m for up_m, _ in known)
    if abs(middle_m) < rules.least_height_m:
        return middle_m, False
    mean_sigma_m = _mean_sigma_m([cell for _, cell in known], rules.map_errors)
    if abs(middle_m) < rules.sigmas * math.hypot(mean_sigma_m, before.correction_sigma_m):
        return middle_m, False
    nearer = [abs(up_m - middle_m) < abs(up_m) for up_m, _ in known]
    newest_m = statistics.median(up_m for up_m, _ in known[-rules.least_cells :])
    goes_on = nearer[0] and abs(newest_m - middle_m) < abs(newest_m)
    half = len(known) // 2
    early_m, late_m = (statistics.median(up_m for up_m, _ in part) for part in (known[:half], known[half:]))
    stands = abs(early_m) >= rules.standing * abs(late_m)
    return middle_m, goes_on and stands and sum(nearer) >= rules.coherent * len(nearer)


def _side(cell: ResidualCell, since_ns: int) -> tuple[float, float, float] | None:
    """Fix less pose, where the pose leans on no fix since then: it owes nothing to those that are in question."""
    return None if cell.anchored_ns is not None and cell.anchored_ns >= since_ns else cell.horizontal_m


def _horizontal(
    sides: Sequence[tuple[float, float, float] | None], rules: CauseRules
) -> tuple[tuple[float, float] | None, bool]:
    known = [side for side in sides if side is not None and side[2] <= rules.horizontal_sigma_limit_m]
    if len(known) < rules.least_cells or len(known) < rules.coherent * len(sides):
        return None, False
    east_m, north_m, sigma_m = (statistics.median(column) for column in zip(*known, strict=True))
    size_m = math.hypot(east_m, north_m)
    if size_m < max(rules.least_horizontal_m, rules.horizontal_sigmas * sigma_m):
        return (east_m, north_m), False
    nearer = [math.hypot(e - east_m, n - north_m) < 0.5 * size_m for e, n, _ in known]
    goes_on = nearer[0] and all(nearer[-2:])
    half = len(known) // 2
    grown_m = math.hypot(
        *(
            statistics.median(side[axis] for side in known[half:])
            - statistics.median(side[axis] for side in known[:half])
            for axis in (0, 1)
        )
    )
    stands = grown_m <= max(rules.least_horizontal_m, rules.horizontal_sigmas * sigma_m)
    return (east_m, north_m), goes_on and stands and sum(nearer) >= rules.coherent * len(nearer)
