"""Learning of the height correction `h_e` (JP7707657B2 eqs. (4), (5)): the error of the antenna height alone.

Learnt only from confirmed positions, at a speed outside the stop range (no re-learning at one spot). Two modes:

- **document**: JP7707657B2 eq. (5) as printed, one number for everything, with gain and cap.
- **per cause** (default): the common part of the height differences on many stretches of road, robustly and with the
  map's error known to be alike along the road. Roads that have changed are left to the map (uploads, a new release); a
  base that is wrong is not learnt, nor is what drifts: that is how spoofing pulls slowly. Capped in value and rate.

What was learnt belongs to an antenna and a base. A new version of the map leaves it as it is, for what was the map's
was never in it; what was known of changed roads is dropped, so the same error is not corrected twice.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.learning.cell_offset import CauseRules
from camber.integrity.learning.common_offset import CommonOffset, HeightDifferences, estimate_common_offset
from camber.integrity.learning.offset_causes import Diagnosis, OffsetCauses, RoadChange
from camber.integrity.learning.residuals import CellCollector, FixResidual, ReferenceKey, ResidualCell
from camber.road_map.map_error_model import MAP_ERRORS, MapErrorModel

Mode = Literal["per_cause", "document"]
_MOST_CELLS = 96  # chosen: some 2 km in cells of 20 m, many times the correlation length of the map's error
_MOST_PARTS = 16  # chosen: more base stations and map versions than one drive meets; bounds the memory
_LONGEST_STEP_S = 10.0  # chosen: a pause in the fixes must not let the correction jump by the rate times it
_LEAST_SIGMA_M = 0.01  # of a stretch: no fix is better, whatever it claims


@dataclass(frozen=True, slots=True, kw_only=True)
class LearningRules:
    """Gain `g` of (5) for the document's mode; lower edge of the speeds at which is learnt; cap of `h_e`; mode.

    Of ours: `rate_m_s`, at most by which it changes; `map_errors`, the model of the map's height errors;
    `prior_sigma_m` of the antenna's height as it was measured; `release_sigma_m`, by which a new map or base may have
    moved it; a drift of `drift_sigmas` and `drift_m` over the memory is not learnt.
    """

    gain: float = 0.01
    least_speed_m_s: float = 3.0
    cap_m: float = 0.3
    mode: Mode = "per_cause"
    rate_m_s: float = 0.003
    map_errors: MapErrorModel = MAP_ERRORS
    prior_sigma_m: float = 0.1
    release_sigma_m: float = 0.05
    drift_sigmas: float = 3.5
    drift_m: float = 0.04
    causes: CauseRules = field(default_factory=CauseRules)


@dataclass(frozen=True, slots=True, kw_only=True)
class Correction:
    """`h_e` in force, σ of what learning has put into it (what was not known before is the antenna's own), and from
    how many positions or stretches it was learnt."""

    correction_m: float = 0.0
    sigma_m: float = 0.0
    samples: int = 0


@dataclass(slots=True, kw_only=True)
class CorrectionState:
    """What was learnt with one antenna and one base, and from which map last."""

    antenna: str
    base: str
    map_version: int
    correction: Correction = Correction()
    prior_m: float = 0.0
    prior_sigma_m: float = 0.1
    cells: deque[tuple[ResidualCell, float]] = field(default_factory=lambda: deque(maxlen=_MOST_CELLS))
    held_m: float | None = None
    """The correction before a drift began; None: nothing drifts."""


class Learning:
    """Learns the height correction, and the causes of offsets, from the residuals of judged fixes in order of time."""

    def __init__(
        self, rules: LearningRules, parts: Sequence[CorrectionState] = (), roads: Sequence[RoadChange] = ()
    ) -> None:
        self.rules = rules
        self.causes = OffsetCauses(replace(rules.causes, map_errors=rules.map_errors), roads)
        self._parts = {(part.antenna, part.base): part for part in parts}
        self._cells = CellCollector(rules.causes.cell_m)

    @property
    def samples(self) -> int:
        """Number of learning steps so far; it grows where there is something new to save."""
        return sum(part.correction.samples for part in self._parts.values())

    @property
    def parts(self) -> tuple[CorrectionState, ...]:
        """What there is to keep, oldest first."""
        return tuple(self._parts.values())

    def correction(self, key: ReferenceKey) -> Correction:
        """In force for this antenna, base and map; nothing where nothing was learnt for them."""
        part = self._parts.get((key.antenna, key.base)) or self._same_antenna(key)
        if part is None:
            return Correction()
        correction = part.correction
        if (part.base, part.map_version) == (key.base, key.map_version) or self.rules.mode == "document":
            return correction
        sigma_m = math.hypot(correction.sigma_m, self.rules.release_sigma_m)
        return replace(correction, sigma_m=sigma_m)

    def diagnosis(self, surface_id: int | None) -> Diagnosis:
        """The cause of a lasting difference on this surface, if one is known."""
        return self.causes.at(surface_id)

    def news(self) -> list[Diagnosis]:
        """The causes named since the last call."""
        return self.causes.news()

    def update(self, residual: FixResidual) -> None:
        """Learn from one judged fix what may be learnt from it."""
        before, roads = self.causes.common, len(self.causes.roads)
        correction = self.correction(residual.key)
        # Until something is learnt, what the survey's heights have in common is in every difference.
        sigma_m = correction.sigma_m if correction.samples else self.rules.map_errors.common_offset_sigma_m
        self.causes.update(residual, correction.correction_m, sigma_m)
        part = self._parts.get((residual.key.antenna, residual.key.base))
        if self.causes.common.cause != before.cause and part is not None:
            self._forget(before, self.causes.common, part)
        if len(self.causes.roads) > roads:
            self._forget_roads()
        if not self._may_learn(residual):
            return
        if self.rules.mode == "document":
            self._learn_by_gain(residual)
            return
        cell = self._cells.add(residual)
        if cell is not None:
            self._learn(cell)

    def _may_learn(self, residual: FixResidual) -> bool:
        speed_m_s = residual.speed_m_s
        return (
            residual.confirmed
            and residual.known_up_m is not None
            and speed_m_s is not None
            and self.rules.least_speed_m_s <= abs(speed_m_s) < math.inf
        )

    def _learn_by_gain(self, residual: FixResidual) -> None:
        """JP7707657B2 eqs. (4) and (5); unchanged where the new one would be beyond the cap."""
        part, observed_m = self._part(residual.key), residual.known_up_m
        assert observed_m is not None
        gain, before = self.rules.gain, part.correction
        learnt_m = (1.0 - gain) * before.correction_m + gain * observed_m
        if abs(learnt_m) <= self.rules.cap_m:
            part.correction = Correction(correction_m=learnt_m, samples=before.samples + 1)

    def _learn(self, cell: ResidualCell) -> None:
        """One step towards the common part of the stretches remembered."""
        part = self._part(cell.key)
        if self.causes.common.is_of_all_fixes or cell.surface_id in self.causes.roads:
            return
        last_ns = part.cells[-1][0].end_ns if part.cells else cell.begin_ns
        part.cells.append((cell, part.correction.correction_m))
        if _may_be_the_road(self.causes.common):
            return
        result = estimate_common_offset(
            _differences(part.cells), self.rules.map_errors, part.prior_m, part.prior_sigma_m
        )
        target_m = self._target_m(part, result)
        step_s = min(max((cell.end_ns - last_ns) / 1e9, 0.0), _LONGEST_STEP_S)
        before_m, most_m = part.correction.correction_m, self.rules.rate_m_s * step_s
        step_m = min(max(target_m - before_m, -most_m), most_m)
        learnt_m = min(max(before_m + step_m, -self.rules.cap_m), self.rules.cap_m)
        sigma_m = math.hypot(result.sigma_m, target_m - learnt_m)
        part.correction = Correction(
            correction_m=learnt_m, sigma_m=sigma_m, samples=part.correction.samples + 1
        )

    def _target_m(self, part: CorrectionState, result: CommonOffset) -> float:
        """Where the correction should go: where it was before a drift began; where it is, if that is beyond the cap."""
        rules = self.rules
        if result.drift_sigmas > rules.drift_sigmas and result.drift_m > rules.drift_m:
            if part.held_m is None:
                part.held_m = part.cells[0][1]
            return part.held_m
        part.held_m = None
        return result.value_m if abs(result.value_m) <= rules.cap_m else part.correction.correction_m

    def _forget(self, earlier: Diagnosis, diagnosis: Diagnosis, part: CorrectionState) -> None:
        """Stretches before an antenna changed say nothing of it; those since a base went wrong were never true.

        What may be the road is not learnt until it is known to be the antenna; where it ends before, it was the road.
        """
        if diagnosis.cause == "none" and _may_be_the_road(earlier):
            self._undo(part, earlier.onset_ns)
        elif _may_be_the_road(diagnosis):
            self._undo(part, diagnosis.onset_ns, keep=True)
        if diagnosis.onset_ns is None or not (diagnosis.cause == "antenna" or diagnosis.is_of_all_fixes):
            return
        if diagnosis.cause == "antenna" and part.held_m is not None:
            return  # what drifts is not made right by having gone far
        since = [(cell, m) for cell, m in part.cells if cell.end_ns > diagnosis.onset_ns]
        part.held_m = None
        if diagnosis.cause == "antenna":
            part.prior_m, part.prior_sigma_m = part.correction.correction_m, self.rules.prior_sigma_m
            part.cells = deque(since, _MOST_CELLS)
            return
        self._undo(part, diagnosis.onset_ns)

    def _forget_roads(self) -> None:
        """Stretches of a road that is known now to have changed say nothing of the antenna: they did not before."""
        known = self.causes.roads
        for part in self._parts.values():
            part.cells = deque((seen for seen in part.cells if seen[0].surface_id not in known), _MOST_CELLS)

    @staticmethod
    def _undo(part: CorrectionState, onset_ns: int | None, *, keep: bool = False) -> None:
        """Take back what was learnt since then; `keep` the stretches, of which it is not known yet."""
        assert onset_ns is not None
        before = [(cell, m) for cell, m in part.cells if cell.end_ns <= onset_ns]
        since = [m for cell, m in part.cells if cell.end_ns > onset_ns]
        if since:
            part.correction = replace(part.correction, correction_m=since[0])
        if not keep:
            part.cells = deque(before, _MOST_CELLS)

    def _part(self, key: ReferenceKey) -> CorrectionState:
        """The part of this antenna and base, made where there is none, fit for this version of the map."""
        part = self._parts.get((key.antenna, key.base))
        if part is None:
            part = self._begin(key)
        elif part.map_version != key.map_version:
            part.map_version = key.map_version
            self._open(part, part.correction)
        return part

    def _begin(self, key: ReferenceKey) -> CorrectionState:
        part = CorrectionState(
            antenna=key.antenna,
            base=key.base,
            map_version=key.map_version,
            prior_sigma_m=math.hypot(self.rules.prior_sigma_m, self.rules.map_errors.common_offset_sigma_m),
        )
        model = self._same_antenna(key)
        if model is not None:
            self._open(part, model.correction)
        self._parts[key.antenna, key.base] = part
        if len(self._parts) > _MOST_PARTS:
            del self._parts[next(iter(self._parts))]
        return part

    def _open(self, part: CorrectionState, correction: Correction) -> None:
        """Begin from what is known, less surely: the differences so far had another cause."""
        sigma_m = math.hypot(correction.sigma_m, self.rules.release_sigma_m)
        part.correction = replace(correction, sigma_m=sigma_m)
        part.prior_m, part.prior_sigma_m = correction.correction_m, sigma_m
        part.held_m = None
        part.cells.clear()

    def _same_antenna(self, key: ReferenceKey) -> CorrectionState | None:
        """The newest part of this antenna with whatever base."""
        return next((p for p in reversed(self._parts.values()) if p.antenna == key.antenna), None)


def _may_be_the_road(diagnosis: Diagnosis) -> bool:
    """Road or antenna, since a moment before which neither was off."""
    return diagnosis.cause == "ambiguous" and diagnosis.after_right


def _differences(cells: Sequence[tuple[ResidualCell, float]]) -> HeightDifferences:
    first = cells[0][0]
    return HeightDifferences(
        up_m=np.array([cell.up_m for cell, _ in cells], np.float64),
        variance_m2=np.array([cell.fix_sigma_m**2 + _LEAST_SIGMA_M**2 for cell, _ in cells]),
        map_sigma_m=np.array([cell.map_sigma_m for cell, _ in cells]),
        place_m=np.array(
            [
                east_north_between(
                    first.latitude_rad, first.longitude_rad, cell.latitude_rad, cell.longitude_rad
                )
                for cell, _ in cells
            ]
        ),
        time_s=np.array([(cell.begin_ns - first.begin_ns) / 1e9 for cell, _ in cells]),
    )
