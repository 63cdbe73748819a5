"""Every message class, and valid instances of them made from their fields.

`build` takes all its choices from a `random.Random`: Hypothesis gives one that it can shrink, golden files use a
seeded one. A message whose fields depend on one another beyond lengths has an entry in `_AGREED`.
"""

from __future__ import annotations

import importlib
import pkgutil
import types
import typing
from collections.abc import Callable
from random import Random
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from hypothesis import strategies as st
from pydantic.fields import FieldInfo

import camber.schemas
from camber.schemas.base import ArrayOf, Message, Model

M = TypeVar("M", bound=Model)
_NAME_CHARACTERS = "abcXYZ019_.:@+-"
_TEXT_CHARACTERS = "ab \n\"'\\{}é高σ😀\0"


def message_classes() -> tuple[type[Message], ...]:
    """Every class of a message in `camber.schemas`, by name."""
    for module in pkgutil.iter_modules(camber.schemas.__path__, "camber.schemas."):
        importlib.import_module(module.name)
    classes = [cls for cls in _below(Message) if cls.__module__.startswith("camber.schemas.")]
    return tuple(sorted(classes, key=lambda cls: cls.__name__))


def messages(cls: type[M]) -> st.SearchStrategy[M]:
    """Any valid instance of a class, for Hypothesis."""
    return st.randoms(use_true_random=False).map(lambda random: build(cls, random))


def build(cls: type[M], random: Random, *, filled: bool = False) -> M:
    """Make an instance; `filled`: nothing is None and nothing is empty."""
    builder = _Builder(random, filled)
    return cls(**builder.fields_of(cls))


def _below(cls: type[Message]) -> list[type[Message]]:
    return [below for sub in cls.__subclasses__() for below in (sub, *_below(sub))]


class _Builder:
    def __init__(self, random: Random, filled: bool) -> None:
        self.random = random
        self.filled = filled
        self.lengths: dict[str, int] = {}

    def fields_of(self, cls: type[Model]) -> dict[str, Any]:
        values = {name: self.value(info.annotation, info.metadata) for name, info in cls.model_fields.items()}
        agreed = _AGREED.get(cls.__name__)
        return values | agreed(self, values) if agreed else values

    def value(self, annotation: Any, metadata: list[Any]) -> Any:
        origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
        if origin is Annotated:
            return self.value(arguments[0], [*metadata, *_flat(arguments[1:])])
        for item in metadata:
            if isinstance(item, ArrayOf):
                return self.array(item)
        if origin in (types.UnionType, typing.Union):
            (known,) = (argument for argument in arguments if argument is not types.NoneType)
            return self.value(known, metadata) if self.filled or self.random.random() < 0.7 else None
        if origin is Literal:
            return self.random.choice(arguments)
        if origin is tuple and arguments[-1] is Ellipsis:
            return tuple(self.value(arguments[0], []) for _ in range(self.length(metadata)))
        if origin is tuple:
            return tuple(self.value(argument, []) for argument in arguments)
        if origin is dict:
            return {
                self.value(arguments[0], []): self.value(arguments[1], [])
                for _ in range(self.length(metadata))
            }
        return self.plain(annotation, metadata)

    def plain(self, annotation: Any, metadata: list[Any]) -> Any:
        if isinstance(annotation, type) and issubclass(annotation, Model):
            inner = _Builder(self.random, self.filled)
            return annotation(**inner.fields_of(annotation))
        if annotation is bool:
            return self.random.random() < 0.5
        if annotation is int:
            least, most = _bounds(metadata, -(2**63), 2**63 - 1)
            if _limit(metadata, "lt") is not None:
                most = _limit(metadata, "lt") - 1
            return self.random.choice([least, most, self.random.randint(least, most)])
        if annotation is float:
            least, most = _bounds(metadata, -1e300, 1e300)
            if _limit(metadata, "gt") is not None:
                least = np.nextafter(_limit(metadata, "gt"), np.inf).item()
            middle = least + (most - least) * self.random.random()
            return float(self.random.choice([least, most, middle, middle]))
        if annotation is str:
            return self.text(metadata)
        raise NotImplementedError(f"no examples of {annotation}")

    def text(self, metadata: list[Any]) -> str:
        pattern = _limit(metadata, "pattern")
        if pattern and "{64}" in pattern:
            return "".join(self.random.choice("0123456789abcdef") for _ in range(64))
        longest = _limit(metadata, "max_length") or 64
        size = self.random.choice([1, 5, longest]) if pattern or self.filled else self.random.randint(0, 9)
        allowed = _NAME_CHARACTERS if pattern else _TEXT_CHARACTERS
        return "a" * min(size, 1) + "".join(self.random.choice(allowed) for _ in range(size - 1))

    def length(self, metadata: list[Any]) -> int:
        return min(self.random.randint(2 if self.filled else 0, 3), _limit(metadata, "max_length") or 3)

    def rows(self, axis: int | str) -> int:
        if isinstance(axis, int):
            return axis
        name, _, more = axis.partition("+")
        if name not in self.lengths:
            self.lengths[name] = self.random.randint(2 if self.filled else 0, 4)
        return self.lengths[name] + int(more or 0)

    def array(self, kind: ArrayOf) -> np.ndarray[Any, Any]:
        shape = tuple(self.rows(axis) for axis in kind.shape)
        dtype = np.dtype(kind.dtype)
        if kind.offsets_into:
            end = self.rows(kind.offsets_into)
            inner = sorted(self.random.randint(0, end) for _ in range(shape[0] - 2))
            if shape[0] == 1:  # no rows: then nothing may be left over either
                self.lengths[kind.offsets_into] = end = 0
            return np.array([0, *inner, end][-shape[0] :], dtype)
        count = int(np.prod(shape))
        if dtype.kind == "f":
            least, most = kind.ge if kind.ge is not None else -1e30, kind.le if kind.le is not None else 1e30
            values: list[Any] = [least + (most - least) * self.random.random() for _ in range(count)]
        else:
            limits = np.iinfo(dtype)
            least = max(limits.min, kind.ge if kind.ge is not None else limits.min)
            most = min(limits.max, kind.le if kind.le is not None else limits.max)
            values = [self.random.randint(int(least), int(most)) for _ in range(count)]
        return np.array(values, dtype).reshape(shape)


def _flat(metadata: tuple[Any, ...]) -> list[Any]:
    return [part for item in metadata for part in (item.metadata if isinstance(item, FieldInfo) else [item])]


def _limit(metadata: list[Any], name: str) -> Any:
    return next((limit for item in metadata if (limit := getattr(item, name, None)) is not None), None)


def _bounds(metadata: list[Any], least: Any, most: Any) -> tuple[Any, Any]:
    low, high = _limit(metadata, "ge"), _limit(metadata, "le")
    return (least if low is None else low), (most if high is None else high)


def _agreed_surface_tile(builder: _Builder, values: dict[str, Any]) -> dict[str, Any]:
    surfaces = len(values["surface_id"])
    rows = np.array([builder.random.randint(2, 3) for _ in range(surfaces)], "<i4")
    columns = np.array([builder.random.randint(2, 3) for _ in range(surfaces)], "<i4")
    ends = np.cumsum(rows * columns)
    grid = np.array([builder.random.uniform(-9.0, 9.0) for _ in range(ends[-1] if surfaces else 0)], "<f4")
    first = (ends - rows * columns).astype("<i4")
    return {"rows": rows, "columns": columns, "first_height": first, "grid_m": grid}


def _agreed_map_decision(builder: _Builder, values: dict[str, Any]) -> dict[str, Any]:
    back = values["action"] == "roll_back"
    needed = {
        "surface_id": None if back else builder.random.randint(0, 2**62),
        "offset_m": None if back else builder.random.uniform(-100.0, 100.0),
        "map_version": builder.random.randint(0, 2**62) if back else None,
    }
    signed = (
        {} if values["key_id"] and values["signature"] is not None else {"key_id": None, "signature": None}
    )
    return needed | signed | {"who": "Ann", "why": "é高 seen on site"}


_AGREED: dict[str, Callable[[_Builder, dict[str, Any]], dict[str, Any]]] = {
    "MapDecision": _agreed_map_decision,
    "SurfaceTile": _agreed_surface_tile,
}
