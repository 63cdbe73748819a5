"""Differences of the methods as text, for the next drive of the same vehicle."""

from __future__ import annotations

import json
from dataclasses import asdict
from hashlib import sha256
from typing import Annotated, Self

from pydantic import Field, ValidationError, model_validator

from camber.antenna_height.available_heights import VehicleGeometry
from camber.antenna_height.change_detection import REMEMBERED_BLOCKS, Reference
from camber.antenna_height.method_comparison import References
from camber.schemas.antenna import HeightMethod
from camber.schemas.base import Model, Sha256

_MOST_M = 10.0  # chosen: two methods that differ by more do not measure one antenna


class _SavedDifference(Model):
    methods: tuple[HeightMethod, HeightMethod]
    blocks: Annotated[float, Field(gt=0.0, le=REMEMBERED_BLOCKS + 1.0)]
    mean_m: Annotated[float, Field(ge=-_MOST_M, le=_MOST_M)]
    squares_m2: Annotated[float, Field(ge=0.0)]

    @model_validator(mode="after")
    def _plausible(self) -> Self:
        if self.methods[0] == self.methods[1]:
            raise ValueError("methods: expected two")
        if self.squares_m2 > self.blocks * _MOST_M**2:
            raise ValueError(f"squares_m2: expected a scatter of at most {_MOST_M:g} m")
        return self


class _SavedState(Model):
    geometry: Sha256
    pairs: Annotated[tuple[_SavedDifference, ...], Field(max_length=16)]


def references_as_text(vehicle: VehicleGeometry, references: References) -> str:
    """Return the references as JSON; those that are empty or not plausible are left out."""
    pairs = []
    for methods, one in references.items():
        try:
            pairs.append(_SavedDifference(methods=methods, **one._asdict()))
        except ValidationError:
            continue
    return _SavedState(geometry=_fingerprint(vehicle), pairs=tuple(pairs)).model_dump_json()


def references_from_text(text: str, vehicle: VehicleGeometry) -> References:
    """Return the references; none where a dimension of the vehicle has changed.

    Raises ValueError for values out of their bounds.
    """
    saved = _SavedState.model_validate_json(text)
    if saved.geometry != _fingerprint(vehicle):
        return {}
    references = {one.methods: Reference(one.blocks, one.mean_m, one.squares_m2) for one in saved.pairs}
    if len(references) != len(saved.pairs):
        raise ValueError("pairs: expected each two methods once")
    return references


def _fingerprint(vehicle: VehicleGeometry) -> str:
    return sha256(json.dumps(asdict(vehicle), sort_keys=True).encode()).hexdigest()
