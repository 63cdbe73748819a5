"""Why do fixes and height model differ, and go on to: antenna, road, base, or what one vehicle cannot determine?

All judged fixes count, also the erroneous ones: one wrong fix is a wrong fix, but where stretch after stretch
differs by the same vector, something else is wrong.

- **base** (or datum): fixes are off by one vector. Its horizontal part shows against the independent position
  (`independent_offset`), by the heights along their own track (`fix_track_offset`), against a scan match, or, without
  an independent position, a pose that leans on no fix since they are off. Heights that are off alike on several links
  by more than any antenna could be show it too.
- **drift**: fixes are led away from the independent position along a growing vector.
- **antenna**: heights are off alike on several links, and the horizontal position is seen to be right.
- **road**: one stretch differs, the roads before and after it do not; and a fix there was verified otherwise, or
  another drive over it found the same.
- **ambiguous**: it lasts, but is one of several: on too few links antenna or road; without an independent pose
  antenna or base. What changed at the onset decides: another base's key, another antenna's.

A base that is wrong in height alone looks like an antenna, unless its key changed. A wrong fix whose integers hold
looks like a wrong base: until a vector has lasted longer than wrong integers do, it is reported as *ambiguous*, though
fixes that are off by it are judged as those of a wrong base from the first. Other integers are a step of the fixes:
where they have made none for as long, wrong integers make no vector, however late the independent position shows it.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from camber.integrity.learning.cell_offset import (
    CauseRules,
    CellOffset,
    SeenCell,
    difference_of,
    is_large,
    offset_of,
)
from camber.integrity.learning.fix_track_offset import TrackFaults
from camber.integrity.learning.independent_offset import IndependentOffsets
from camber.integrity.learning.residuals import CellCollector, FixResidual, ResidualCell, distance_m
from camber.schemas.integrity import Cause

ISSUE_CODES: dict[Cause, str] = {
    "antenna": "antenna_changed",
    "road": "road_changed",
    "base": "base_wrong",
    "drift": "fixes_led_away",
    "ambiguous": "cause_ambiguous",
}
"""Under which a named cause stands in health."""

_MOST_CELLS = 40  # chosen: the newest cells that are searched for a common offset; bounds time and memory


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """A cause with its onset, its vector as far as it is known, and for a road its surface.

    `after_right`: as many stretches before its onset were seen as a cause needs, and did not differ so.
    `may_be_integers`: neither it nor the integers of the fixes have lasted longer than wrong ones do, which explain it
    as well as a wrong base.
    """

    cause: Cause = "none"
    onset_ns: int | None = None
    up_m: float | None = None
    east_north_m: tuple[float, float] | None = None
    surface_id: int | None = None
    text: str = ""
    after_right: bool = False
    may_be_integers: bool = False

    @property
    def is_of_all_fixes(self) -> bool:
        """Are all fixes off sideways by one vector? Then their heights are those of other places."""
        return self.cause in ("base", "drift")

    @property
    def reported(self) -> Cause:
        """The cause as far as it is known."""
        return "ambiguous" if self.may_be_integers else self.cause


NO_OFFSET = Diagnosis()


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadChange:
    """A surface that lies otherwise than this version of the map says."""

    surface_id: int
    map_version: int
    offset_m: float
    onset_ns: int


class OffsetCauses:
    """Determines the cause from residuals in the order of time. `roads`: those known to have changed, by surface."""

    def __init__(self, rules: CauseRules, roads: Sequence[RoadChange] = ()) -> None:
        self.rules = rules
        self.common = NO_OFFSET
        self.roads = {road.surface_id: road for road in roads}
        self._independent = IndependentOffsets(rules.independent)
        self._fix_track = TrackFaults(rules.fix_track)
        self._collector = CellCollector(rules.cell_m)
        self._map_version = roads[0].map_version if roads else None
        self._seen: deque[SeenCell] = deque(maxlen=_MOST_CELLS)
        self._run: list[SeenCell] = []  # of deviating cells since the last that did not deviate
        self._whole = False  # is the cell before that run known not to have deviated?
        self._suspects: dict[int, tuple[float, int]] = {}  # surface: offset and time of the pass
        self._news: list[Diagnosis] = []

    def at(self, surface_id: int | None) -> Diagnosis:
        """The cause of a difference on this surface: a road known to have changed goes before an ambiguous cause."""
        road = self.roads.get(surface_id) if surface_id is not None else None
        is_determined = self.common.cause not in ("none", "ambiguous")
        return self.common if road is None or is_determined else _diagnosis_of(road)

    def news(self) -> list[Diagnosis]:
        """What has been named since the last call."""
        news, self._news = self._news, []
        return news

    def update(self, residual: FixResidual, correction_m: float, correction_sigma_m: float = 0.0) -> None:
        """Take a residual, whatever its verdict; `correction_m` is that in force, with its σ."""
        sampled, cell = self._independent.update(residual), self._collector.add(residual)
        sampled = self._fix_track.update(residual.track_offset, residual.key.base) or sampled
        if cell is not None:
            self._add(SeenCell(cell=cell, correction_m=correction_m, correction_sigma_m=correction_sigma_m))
        if sampled or cell is not None:
            self._name(self._current_cause(), residual)

    def _add(self, seen: SeenCell) -> None:
        cell = seen.cell
        if cell.up_m is not None and cell.key.map_version != self._map_version:
            if self._map_version is not None:  # else nothing here is from another map
                self._forget_map(cell.key.map_version)
            self._map_version = cell.key.map_version
        self._seen.append(seen)
        self._follow_roads(seen)

    def _forget_map(self, version: int) -> None:
        """Differences from another map are none from this one."""
        self._seen.clear()
        self._run, self._whole, self._suspects = [], False, {}
        self.roads = {key: road for key, road in self.roads.items() if road.map_version == version}

    def _name(self, result: Diagnosis, newest: FixResidual) -> None:
        before, may_be_integers = self.common, True
        if result.cause == before.cause:
            # It began when it was first seen to begin, and after what, also when that has left the memory.
            result = replace(result, onset_ns=before.onset_ns, after_right=before.after_right)
            may_be_integers = before.may_be_integers
        if may_be_integers and _may_be_integers(result, newest, self.rules):
            result = replace(result, may_be_integers=True, text=f"{result.text}, or wrong integers")
        if result.cause != "none" and (result.cause, result.reported) != (before.cause, before.reported):
            self._news.append(result)
        self.common = result

    def _current_cause(self) -> Diagnosis:
        """What the independent position shows goes first, as its vector is that of now; then what heights show."""
        cells, fault = self._common_cause(), self._independent.fault
        if fault is None and self._fix_track.fault is not None:
            offset = self._fix_track.fault
            diagnosis = Diagnosis(
                cause=offset.kind, onset_ns=offset.begin_ns, up_m=cells.up_m, east_north_m=offset.east_north_m
            )
            return _with_detail(diagnosis, offset.describe())
        if fault is None:
            return cells
        diagnosis = Diagnosis(
            cause=fault.kind, onset_ns=fault.onset_ns, up_m=cells.up_m, east_north_m=fault.east_north_m
        )
        return _with_detail(diagnosis, fault.describe())

    def _common_cause(self) -> Diagnosis:
        """Of the longest row of newest cells that differ by one vector."""
        seen = list(self._seen)
        for first in range(len(seen) - self.rules.least_cells + 1):
            if first == 0 and len(seen) == _MOST_CELLS and self.common.cause == "none":
                continue  # its beginning has not been seen
            offset = offset_of(seen, first, self.rules)
            if offset is not None:
                cells = [s.cell for s in seen[first:]]
                before = seen[first - 1].cell if first else None
                result = _cause_of(cells, before, offset, self.rules)
                after_right = result is not NO_OFFSET and first >= self.rules.least_cells
                return replace(result, after_right=after_right)
        return NO_OFFSET

    def _follow_roads(self, seen: SeenCell) -> None:
        """Has a stretch that differs ended, with a road before it and after it that does not?"""
        differs = difference_of(seen)
        if differs is None:
            self._run, self._whole = [], False
        elif is_large(seen.cell, differs, self.rules):
            self._run.append(seen)
        else:
            if self._whole and self._run:
                self._close(self._run)
            self._run, self._whole = [], True

    def _close(self, run: list[SeenCell]) -> None:
        for surface_id in {s.cell.surface_id for s in run} - {None}:
            assert surface_id is not None
            here = [s for s in run if s.cell.surface_id == surface_id]
            others = [s for s in self._seen if s.cell.surface_id == surface_id and s not in run]
            if any(s.cell.begin_ns >= run[0].cell.begin_ns - round(1e9 * self.rules.again_s) for s in others):
                continue  # a part of it does not differ: it is not the surface
            offset_m = statistics.median(d for s in here if (d := difference_of(s)) is not None)
            self._suspect(surface_id, offset_m, here)

    def _suspect(self, surface_id: int, offset_m: float, here: list[SeenCell]) -> None:
        """Named where the fixes were verified otherwise, or an earlier pass found the same."""
        begin_ns, rules = here[0].cell.begin_ns, self.rules
        verified = 2 * sum(s.cell.verified for s in here) >= sum(s.cell.fixes for s in here)
        earlier = self._suspects.get(surface_id)
        again = (
            earlier is not None
            and begin_ns - earlier[1] >= rules.again_s * 1e9
            and abs(earlier[0] - offset_m) <= rules.least_height_m
        )
        if not again:
            self._suspects[surface_id] = (offset_m, begin_ns)
        if not (verified or again) or surface_id in self.roads:
            return
        onset_ns = earlier[1] if again and earlier is not None else begin_ns
        road = RoadChange(
            surface_id=surface_id,
            map_version=here[0].cell.key.map_version,
            offset_m=offset_m,
            onset_ns=onset_ns,
        )
        self.roads[surface_id] = road
        self._news.append(_diagnosis_of(road))


def _cause_of(
    cells: Sequence[ResidualCell], before: ResidualCell | None, offset: CellOffset, rules: CauseRules
) -> Diagnosis:
    """Of a row of cells that differ by one vector."""
    if (cells[-1].end_ns - cells[0].begin_ns) / 1e9 < _least_s(offset, rules):
        return NO_OFFSET
    diagnosis = Diagnosis(
        cause="ambiguous", onset_ns=cells[0].begin_ns, up_m=offset.up_m, east_north_m=offset.east_north_m
    )
    if offset.horizontal_outcome:
        return _with_detail(replace(diagnosis, cause="base"), "fixes are off by one vector")
    if before is not None:
        new_antenna = before.key.antenna != cells[0].key.antenna
        new_base = before.key.base != cells[0].key.base
        if new_base and not new_antenna:
            return _with_detail(replace(diagnosis, cause="base"), "since the base changed")
        if new_antenna and not new_base:
            return _with_detail(replace(diagnosis, cause="antenna"), "since the antenna changed")
    cells_on = Counter(cell.link_id for cell in cells if cell.link_id is not None)
    links = sum(count >= rules.link_cells for count in cells_on.values())
    driven_m = sum(distance_m(a, b) for a, b in itertools.pairwise(cells))
    if links < rules.antenna_links or driven_m < rules.antenna_distance_m:
        other = "base" if offset.up_m is not None and abs(offset.up_m) > rules.antenna_limit_m else "antenna"
        return _with_detail(diagnosis, f"{other} or road, {links} links so far")
    if offset.up_m is not None and abs(offset.up_m) > rules.antenna_limit_m:
        return _with_detail(replace(diagnosis, cause="base"), "base or datum: more than any antenna could be")
    if offset.east_north_m is None:
        return _with_detail(diagnosis, "antenna or base: no pose that owes nothing to fixes")
    return _with_detail(replace(diagnosis, cause="antenna"), f"alike on {links} links")


def _may_be_integers(diagnosis: Diagnosis, newest: FixResidual, rules: CauseRules) -> bool:
    """Whether a vector, not the key of another base, names a base, and wrong integers may have lasted as long.

    They have lasted since its onset, or since the last step of the fixes where that was before.
    """
    if diagnosis.cause != "base" or diagnosis.east_north_m is None or diagnosis.onset_ns is None:
        return False
    begin_ns = diagnosis.onset_ns
    if newest.run_begin_ns is not None:
        begin_ns = min(begin_ns, newest.run_begin_ns)
    return newest.time_ns - begin_ns < rules.wrong_integers_s * 1e9


def _least_s(offset: CellOffset, rules: CauseRules) -> float:
    if not offset.horizontal_outcome or offset.east_north_m is None:
        return rules.least_s
    return rules.least_far_s if math.hypot(*offset.east_north_m) > rules.far_m else rules.least_horizontal_s


def _with_detail(diagnosis: Diagnosis, why: str) -> Diagnosis:
    parts = [f"{diagnosis.up_m:+.2f} m up"] if diagnosis.up_m is not None else []
    if diagnosis.east_north_m is not None:
        parts.append("{:+.2f} m east, {:+.2f} m north".format(*diagnosis.east_north_m))
    return replace(diagnosis, text=f"{', '.join(parts)}: {why}")


def _diagnosis_of(road: RoadChange) -> Diagnosis:
    text = f"surface {road.surface_id} lies {road.offset_m:+.2f} m from map version {road.map_version}"
    return Diagnosis(
        cause="road",
        onset_ns=road.onset_ns,
        up_m=road.offset_m,
        surface_id=road.surface_id,
        text=text,
    )
