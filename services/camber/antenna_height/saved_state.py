"""What the differences of ways have been, as text: for the next drive of the same vehicle."""

from __future__ import annotations

from hashlib import sha256

from pydantic import BaseModel, ConfigDict, Field

from camber.antenna_height.available_heights import Vehicle
from camber.antenna_height.change_detection import Reference
from camber.antenna_height.method_comparison import References
from camber.schemas.antenna import HeightMethod


class _Pair(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    ways: tuple[HeightMethod, HeightMethod]
    blocks: float = Field(ge=0.0)
    mean_m: float
    squares_m2: float = Field(ge=0.0)


class _Kept(BaseModel):
    model_config = ConfigDict(extra="forbid")
    vehicle: str
    pairs: tuple[_Pair, ...]


def references_as_text(vehicle: Vehicle, references: References) -> str:
    """JSON."""
    pairs = tuple(
        _Pair(ways=ways, blocks=one.count, mean_m=one.mean_m, squares_m2=one.squares_m2)
        for ways, one in references.items()
    )
    return _Kept(vehicle=_fingerprint(vehicle), pairs=pairs).model_dump_json(indent=1)


def references_from_text(text: str, vehicle: Vehicle) -> References:
    """Empty where something of the vehicle has been measured anew since. Raises ValueError for damaged text."""
    kept = _Kept.model_validate_json(text)
    if kept.vehicle != _fingerprint(vehicle):
        return {}
    return {one.ways: Reference(one.blocks, one.mean_m, one.squares_m2) for one in kept.pairs}


def _fingerprint(vehicle: Vehicle) -> str:
    return sha256(repr(vehicle).encode()).hexdigest()
