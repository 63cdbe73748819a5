"""Messages are frozen, strict, equal by value, and say how long each of their lists may be."""

from __future__ import annotations

from random import Random
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from pydantic.json_schema import GenerateJsonSchema

from camber.schemas.base import EARLIEST_NS, LATEST_NS, MAX_ITEMS, Message
from camber.schemas.gnss import Fix, ReceiverBytes
from camber.schemas.road import SurfaceTile
from support.messages import build, message_classes

every_message = pytest.mark.parametrize("cls", message_classes(), ids=lambda cls: cls.__name__)


def filled(cls: type[Message], seed: int = 1) -> Any:
    return build(cls, Random(seed), filled=True)


@every_message
def test_a_field_cannot_be_changed(cls: type[Message]) -> None:
    with pytest.raises(ValidationError, match="frozen"):
        filled(cls).time_ns = EARLIEST_NS


@every_message
def test_messages_are_equal_when_their_fields_are(cls: type[Message]) -> None:
    assert filled(cls) == filled(cls)
    assert filled(cls) != filled(cls).model_copy(update={"time_ns": filled(cls).time_ns ^ 1})
    assert filled(cls) != "a message"


def test_messages_differ_when_their_arrays_do() -> None:
    time, data = filled(Fix).time_ns, np.arange(3, dtype="u1")
    one = ReceiverBytes(time_ns=time, protocol="ubx", payload=data)
    assert one == ReceiverBytes(time_ns=time, protocol="ubx", payload=data)
    assert one != ReceiverBytes(time_ns=time, protocol="ubx", payload=data[::-1])
    assert one != ReceiverBytes(time_ns=time, protocol="ubx", payload=data[:2])


def test_messages_without_arrays_can_be_kept_in_sets() -> None:
    assert len({filled(Fix), filled(Fix), filled(Fix, seed=2)}) == 2


@pytest.mark.parametrize("time_ns", [EARLIEST_NS - 1, LATEST_NS + 1, 0, -1])
def test_a_time_before_2000_or_after_2080_is_refused(time_ns: int) -> None:
    with pytest.raises(ValidationError, match="time_ns"):
        Fix(**filled(Fix).model_dump() | {"time_ns": time_ns})


class Limits(GenerateJsonSchema):
    """The schema of a message; what it says of arrays is checked elsewhere."""

    def handle_invalid_for_json_schema(self, schema: Any, error_info: str) -> dict[str, Any]:
        return {}


def schemas_within(cls: type[Message], kind: str) -> list[dict[str, Any]]:
    """The schemas of this kind of all that a message may hold."""
    parts, waiting = [], [cls.model_json_schema(schema_generator=Limits)]
    while waiting:
        part = waiting.pop()
        parts += [part] if isinstance(part, dict) and part.get("type") == kind else []
        waiting += part.values() if isinstance(part, dict) else part if isinstance(part, list) else []
    return parts


@every_message
def test_every_list_and_mapping_says_how_long_it_may_be(cls: type[Message]) -> None:
    mappings = [part for part in schemas_within(cls, "object") if "properties" not in part]
    for part in schemas_within(cls, "array") + mappings:
        longest = part.get("maxItems", part.get("maxProperties"))
        assert longest is not None, f"{part} needs a max_length"
        assert longest <= MAX_ITEMS, f"{part}: records belong into arrays"


@every_message
def test_every_integer_fits_into_64_bits(cls: type[Message]) -> None:
    for part in schemas_within(cls, "integer"):
        bounds = [part[side] for side in part if side.endswith(("inimum", "aximum"))]
        assert len(bounds) == 2, f"{part} needs a least and a greatest value"
        assert all(-(2**63) <= bound < 2**63 for bound in bounds)


def test_a_grid_beyond_the_heights_is_refused() -> None:
    tile = filled(SurfaceTile)
    fields = dict(tile.__dict__)
    for bad in ({"grid_m": tile.grid_m[:-1]}, {"rows": np.full_like(tile.rows, 2**31 - 1)}):
        with pytest.raises(ValidationError, match="grid ends beyond"):
            SurfaceTile(**fields | bad)
