"""Differences of the methods as text, for the next drive of the same vehicle."""

from __future__ import annotations

import re
from hashlib import sha256

from pydantic import BaseModel, ConfigDict, Field

from camber.antenna_height.available_heights import VehicleGeometry
from camber.antenna_height.change_detection import Reference
from camber.antenna_height.method_comparison import References
from camber.schemas.antenna import HeightMethod

_FIRST_NAMES = {
    "VehicleGeometry": "Vehicle",
    "FixedHeight": "FixedWay",
    "StrokeGeometry": "StrokeWay",
    "RangingGeometry": "RangingWay",
}
"""Names of classes in the fingerprints of saved files: a file stays valid when a class is renamed."""


class _SavedDifference(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    methods: tuple[HeightMethod, HeightMethod] = Field(alias="ways")
    blocks: float = Field(ge=0.0)
    mean_m: float
    squares_m2: float = Field(ge=0.0)


class _SavedState(BaseModel):
    model_config = ConfigDict(extra="forbid")
    vehicle: str
    pairs: tuple[_SavedDifference, ...]


def references_as_text(vehicle: VehicleGeometry, references: References) -> str:
    """Return the references as JSON."""
    pairs = tuple(
        _SavedDifference(ways=methods, blocks=one.blocks, mean_m=one.mean_m, squares_m2=one.squares_m2)
        for methods, one in references.items()
    )
    return _SavedState(vehicle=_fingerprint(vehicle), pairs=pairs).model_dump_json(indent=1, by_alias=True)


def references_from_text(text: str, vehicle: VehicleGeometry) -> References:
    """Return the references; none where a dimension of the vehicle has changed. ValueError for damaged text."""
    saved = _SavedState.model_validate_json(text)
    if saved.vehicle != _fingerprint(vehicle):
        return {}
    return {one.methods: Reference(one.blocks, one.mean_m, one.squares_m2) for one in saved.pairs}


def _fingerprint(vehicle: VehicleGeometry) -> str:
    text = re.sub(r"\w+(?=\()", lambda name: _FIRST_NAMES.get(name[0], name[0]), repr(vehicle))
    return sha256(text.encode()).hexdigest()
