"""Shift a recorded message in time: all instants by one offset; durations and all other fields unchanged."""

from __future__ import annotations

import functools
import typing
from typing import Any, TypeVar

from pydantic.fields import FieldInfo

from camber.schemas.base import EARLIEST_NS, Message, Model

M = TypeVar("M", bound=Message)

NS_PER_FIX_ID = 1_000_000
"""A fix_id is the millisecond of its epoch, shifted too: integrity ignores a fix_id that already had its verdict."""


def moved(message: M, offset_ns: int) -> M:
    """Return `message` shifted by `offset_ns`: whole milliseconds, the unit of fix ids."""
    if offset_ns % NS_PER_FIX_ID:
        raise ValueError(f"offset of {offset_ns} ns, expected whole milliseconds")
    return typing.cast(M, _moved(message, offset_ns))


def instants(model: type[Model]) -> tuple[str, ...]:
    """Return the names of a model's fields that are instants."""
    return tuple(name for name, info in model.model_fields.items() if _is_instant(info))


def _moved(model: Model, offset_ns: int) -> Model:
    instant_fields, parts = _plan(type(model))
    shifts = dict.fromkeys(instant_fields, offset_ns)
    if "fix_id" in type(model).model_fields:
        shifts["fix_id"] = offset_ns // NS_PER_FIX_ID
    values = {name: getattr(model, name) for name in shifts}
    update: dict[str, Any] = {
        name: value + shifts[name] for name, value in values.items() if value is not None
    }
    for name in parts:
        value = getattr(model, name)
        if isinstance(value, Model):
            update[name] = _moved(value, offset_ns)
        elif isinstance(value, tuple) and value and isinstance(value[0], Model):
            update[name] = tuple(_moved(part, offset_ns) for part in value)
    return model.model_copy(update=update)


@functools.cache
def _plan(model: type[Model]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of fields that are instants, and that may contain models."""
    parts = tuple(name for name, info in model.model_fields.items() if _holds_a_model(info.annotation))
    return instants(model), parts


def _is_instant(info: FieldInfo) -> bool:
    return any(_is_earliest(item) for item in [*info.metadata, *_metadata(info.annotation)])


def _is_earliest(item: Any) -> bool:
    if isinstance(item, FieldInfo):
        return any(map(_is_earliest, item.metadata))
    return getattr(item, "ge", None) == EARLIEST_NS


def _metadata(annotation: Any) -> list[Any]:
    direct = list(annotation.__metadata__) if hasattr(annotation, "__metadata__") else []
    return direct + [item for argument in typing.get_args(annotation) for item in _metadata(argument)]


def _holds_a_model(annotation: Any) -> bool:
    if isinstance(annotation, type):
        return issubclass(annotation, Model)
    return any(_holds_a_model(argument) for argument in typing.get_args(annotation))
