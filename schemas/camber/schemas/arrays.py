"""Numpy arrays as fields of a message: what they must look like, and how their lengths go together."""

from __future__ import annotations

import functools
import typing
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import core_schema

DTYPES = frozenset({"<f8", "<f4", "<i8", "<i4", "<i2", "|i1", "|u1", "<u2", "<u4", "<u8"})
MAX_NDIM = 3  # of the wire format: no message has arrays of more dimensions


@dataclass(frozen=True, slots=True)
class ArrayOf:
    """Annotation of a numpy field: dtype (little-endian code), shape, range of the values.

    A name in the shape stands for a length: arrays of one message that use the same name have the same length
    there; `"links+1"` is one more than `"links"`. With `offsets_into="vertices"` the values are where each
    row's share of `vertices` begins: from 0, never falling, the last one the length of `vertices`.
    """

    dtype: str
    shape: tuple[int | str, ...]
    ge: float | None = None
    le: float | None = None
    offsets_into: str | None = None

    def __post_init__(self) -> None:
        if self.dtype not in DTYPES or not 1 <= len(self.shape) <= MAX_NDIM:
            raise ValueError(f"the codec carries no arrays of {self.dtype} {self.shape}")

    def check(self, value: object) -> npt.NDArray[Any]:
        """Return `value` as an array that nobody can change, or raise ValueError that says what was expected.

        An array that somebody else may still write to is copied.
        """
        if type(value) is not np.ndarray:
            raise ValueError(f"expected an array of {self.dtype} {self.shape}")
        if value.dtype != np.dtype(self.dtype):
            raise ValueError(f"expected dtype {self.dtype}, got {value.dtype}")
        if value.ndim != len(self.shape) or any(
            isinstance(want, int) and have != want for have, want in zip(value.shape, self.shape, strict=True)
        ):
            raise ValueError(f"expected shape {self.shape}, got {value.shape}")
        if value.size:
            self._check_values(value)
        if value.flags.writeable or (isinstance(value.base, np.ndarray) and value.base.flags.writeable):
            value = value.copy()
            value.flags.writeable = False
        return value

    def _check_values(self, value: npt.NDArray[Any]) -> None:
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise ValueError("expected finite numbers")
        if self.ge is not None and (least := value.min()) < self.ge:
            raise ValueError(f"expected values of at least {self.ge}, got {least}")
        if self.le is not None and (greatest := value.max()) > self.le:
            raise ValueError(f"expected values of at most {self.le}, got {greatest}")
        if self.offsets_into is not None and (value[0] != 0 or (value[1:] < value[:-1]).any()):
            raise ValueError("expected offsets from 0 that never fall")

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(self.check)


def check_lengths(message: BaseModel) -> None:
    """Raise ValueError unless arrays of one named length have it, and offsets end where they should."""
    arrays = arrays_of(type(message))
    if not arrays:
        return
    values = message.__dict__
    lengths: dict[str, tuple[str, int]] = {}
    for field, kind in arrays:
        if values[field] is None:
            continue
        for axis, have in zip(kind.shape, values[field].shape, strict=True):
            if isinstance(axis, str):
                name, more = _named(axis)
                first, want = lengths.setdefault(name, (field, have - more))
                if have - more != want:
                    raise ValueError(f"{field} has {have} rows where {first} has {want} {name}")
    for field, kind in arrays:
        if kind.offsets_into is not None and values[field] is not None:
            end = lengths[kind.offsets_into][1] if kind.offsets_into in lengths else 0
            if not len(values[field]) or values[field][-1] != end:
                raise ValueError(f"{field} does not end at the {end} {kind.offsets_into}")


@functools.cache
def arrays_of(cls: type[BaseModel]) -> tuple[tuple[str, ArrayOf], ...]:
    """The array fields of a message class, with or without `| None`, and what is expected of each."""
    fields = []
    for field, info in cls.model_fields.items():
        within = [item for part in typing.get_args(info.annotation) for item in typing.get_args(part)]
        fields += [(field, item) for item in (*info.metadata, *within) if isinstance(item, ArrayOf)]
    return tuple(fields)


@functools.cache
def _named(axis: str) -> tuple[str, int]:
    name, _, more = axis.partition("+")
    return name, int(more or 0)
