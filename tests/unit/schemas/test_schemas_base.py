"""Messages are frozen, strict, equal by value, and say how long each of their lists may be."""

from __future__ import annotations

import types
import typing
from random import Random
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel, ValidationError

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


def variable_parts(annotation: Any, metadata: list[Any]) -> list[tuple[Any, list[Any]]]:
    """The tuples without a fixed length and the mappings within an annotation, with what limits each."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return variable_parts(arguments[0], [*metadata, *arguments[1:]])
    if origin is np.ndarray:
        return []
    here = [(annotation, metadata)] if origin is dict or (origin is tuple and Ellipsis in arguments) else []
    return here + [result for argument in arguments for result in variable_parts(argument, [])]


def models_within(cls: type[BaseModel]) -> set[type[BaseModel]]:
    result = {cls}
    for info in cls.model_fields.values():
        parts = [info.annotation]
        while parts:
            part = parts.pop()
            parts += typing.get_args(part)
            if isinstance(part, type) and issubclass(part, BaseModel):
                result |= models_within(part)
    return result


@every_message
def test_every_list_says_how_long_it_may_be(cls: type[Message]) -> None:
    for model in models_within(cls):
        for name, info in model.model_fields.items():
            for annotation, metadata in variable_parts(info.annotation, list(info.metadata)):
                longest = next((m.max_length for m in metadata if hasattr(m, "max_length")), None)
                assert longest is not None, f"{model.__name__}.{name} ({annotation}) needs a max_length"
                assert longest <= MAX_ITEMS, f"{model.__name__}.{name}: records belong into arrays"


def integers_within(annotation: Any, metadata: list[Any]) -> list[list[Any]]:
    """What limits each integer within an annotation."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        inner = [part for item in arguments[1:] for part in getattr(item, "metadata", [item])]
        return integers_within(arguments[0], [*metadata, *inner])
    passed = metadata if origin in (typing.Union, types.UnionType) else []
    result = [metadata] if annotation is int else []
    return result + [limits for argument in arguments for limits in integers_within(argument, passed)]


@every_message
def test_every_integer_fits_into_64_bits(cls: type[Message]) -> None:
    for model in models_within(cls):
        for name, info in model.model_fields.items():
            for limits in integers_within(info.annotation, list(info.metadata)):
                bounds = [getattr(m, side, None) for m in limits for side in ("ge", "gt", "le", "lt")]
                known = [bound for bound in bounds if bound is not None]
                assert len(known) == 2, f"{model.__name__}.{name} needs a least and a greatest value"
                assert all(-(2**63) <= bound < 2**63 for bound in known)


def test_a_grid_beyond_the_heights_is_refused() -> None:
    tile = filled(SurfaceTile)
    fields = dict(tile.__dict__)
    for bad in ({"grid_m": tile.grid_m[:-1]}, {"rows": np.full_like(tile.rows, 2**31 - 1)}):
        with pytest.raises(ValidationError, match="grid ends beyond"):
            SurfaceTile(**fields | bad)
