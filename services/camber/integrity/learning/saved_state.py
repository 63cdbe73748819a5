"""What was learnt, as text that is kept over a restart. Values out of their bounds are refused whole."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from pydantic import Field

from camber.integrity.learning.height_correction import Correction, CorrectionState, Learning, LearningRules
from camber.integrity.learning.offset_causes import RoadChange
from camber.schemas.base import Count, Model, TimeNs

_Key = Annotated[str, Field(max_length=200)]
_ROAD_OFFSET_M = 10.0  # chosen: a rebuilt road moves by metres; farther away is another one


class _SavedCorrection(Model):
    antenna: _Key
    base: _Key
    map_version: Count
    correction_m: float
    sigma_m: Annotated[float, Field(ge=0.0, le=1.0)]
    samples: Count


class _SavedRoadChange(Model):
    surface_id: Count
    map_version: Count
    offset_m: Annotated[float, Field(ge=-_ROAD_OFFSET_M, le=_ROAD_OFFSET_M)]
    onset_ns: TimeNs


class _SavedLearning(Model):
    parts: Annotated[tuple[_SavedCorrection, ...], Field(max_length=64)]
    roads: Annotated[tuple[_SavedRoadChange, ...], Field(max_length=4096)]


def to_text(learning: Learning) -> str:
    """Everything worth keeping; the stretches in memory are not: after a restart they are seen anew."""
    parts = tuple(
        _SavedCorrection(
            antenna=part.antenna,
            base=part.base,
            map_version=part.map_version,
            correction_m=part.correction.correction_m,
            sigma_m=min(part.correction.sigma_m, 1.0),
            samples=part.correction.samples,
        )
        for part in learning.parts
    )
    roads = tuple(
        _SavedRoadChange(**asdict(road))
        for road in learning.causes.roads.values()
        if abs(road.offset_m) <= _ROAD_OFFSET_M
    )
    return _SavedLearning(parts=parts, roads=roads[-4096:]).model_dump_json()


def from_text(text: str, rules: LearningRules) -> Learning:
    """The reverse. Raises ValueError, which says what was expected where."""
    kept = _SavedLearning.model_validate_json(text)
    for part in kept.parts:
        if not abs(part.correction_m) <= rules.cap_m:
            raise ValueError(
                f"correction_m is {part.correction_m}, expected a number within ±{rules.cap_m} m"
            )
    keys = {(part.antenna, part.base) for part in kept.parts}
    if len(keys) != len(kept.parts):
        raise ValueError("parts: expected each antenna and base once")
    return Learning(
        rules,
        [_part_of(part, rules) for part in kept.parts],
        [RoadChange(**road.model_dump()) for road in kept.roads],
    )


def _part_of(kept: _SavedCorrection, rules: LearningRules) -> CorrectionState:
    """As a prior it is less sure than it was: load and tyres change while a vehicle stands."""
    sigma_m = max(kept.sigma_m, rules.release_sigma_m)
    return CorrectionState(
        antenna=kept.antenna,
        base=kept.base,
        map_version=kept.map_version,
        correction=Correction(correction_m=kept.correction_m, sigma_m=kept.sigma_m, samples=kept.samples),
        prior_m=kept.correction_m,
        prior_sigma_m=sigma_m,
    )
