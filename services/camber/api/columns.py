"""Results as columns: numpy arrays by name, and a pandas DataFrame of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

from camber.schemas.base import Message

_DTYPES: dict[type, Any] = {bool: np.bool_, int: np.int64, float: np.float64, str: np.str_}
_ABSENT: dict[type, Any] = {bool: False, int: -1, float: np.nan, str: ""}
"""Integers of messages are numbers, counts and times: none is negative."""


class Columns(Mapping[str, NDArray[Any]]):
    """Arrays of one length by name: (n,), or (n, k) of what has k components. Times are nanoseconds of GPS time.

    What is absent is NaN, −1 where numbers are integers, '' where they are texts.
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Raise ValueError where the lengths differ."""
        lengths = {len(column) for column in columns.values()}
        if len(lengths) > 1:
            raise ValueError(f"columns of lengths {sorted(lengths)}, expected one length")
        self._columns = dict(columns)
        self.rows = lengths.pop() if lengths else 0

    @classmethod
    def of_messages(cls, kind: type[Message], messages: Iterable[Message]) -> Columns:
        """One row a message, one column for each field of a number, a text, a truth value or several of them.

        Fields that are messages themselves are left out. Several texts are joined by spaces.
        """
        rows = list(messages)
        columns = {}
        for name, field in kind.model_fields.items():
            column = _of_field(field.annotation, [getattr(row, name) for row in rows])
            if column is not None:
                columns[name] = column
        return cls(columns)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        return f"Columns of {self.rows} rows: {', '.join(self._columns)}"

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame; a column (n, k) becomes k of them, `name_0` and so on.

        Raises ModuleNotFoundError without pandas, which the extra `pandas` installs.
        """
        import pandas

        flat: dict[str, NDArray[Any]] = {}
        for name, column in self._columns.items():
            parts = {name: column} if column.ndim == 1 else _parts(name, column)
            flat.update(parts)
        return pandas.DataFrame(flat)


def _parts(name: str, column: NDArray[Any]) -> dict[str, NDArray[Any]]:
    return {f"{name}_{k}": column[:, k] for k in range(column.shape[1])}


def _of_field(annotation: Any, values: list[Any]) -> NDArray[Any] | None:
    """The column of a field by its type; None for messages, arrays and what has no fixed number of components."""
    kind, components = _kind(annotation)
    if kind is None:
        return None
    absent = _ABSENT[kind]
    if components is None:
        return np.array([absent if value is None else value for value in values], _DTYPES[kind])
    if kind is str:
        return np.array(["" if value is None else " ".join(value) for value in values], np.str_)
    if components == 0:
        return None
    rows = [(absent,) * components if value is None else value for value in values]
    return np.array(rows, _DTYPES[kind]).reshape(len(values), components)


def _kind(annotation: Any) -> tuple[type | None, int | None]:
    """The type of the values, and how many: None for a single one, 0 for any number."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(arguments[0])
    if origin is Literal:
        return type(arguments[0]), None
    if origin in (Union, UnionType):
        kinds = {_kind(argument) for argument in arguments if argument is not NoneType}
        return kinds.pop() if len(kinds) == 1 else (None, None)
    if origin is tuple:
        several = arguments[-1] is Ellipsis
        each = {_kind(argument)[0] for argument in arguments if argument is not Ellipsis}
        return (each.pop() if len(each) == 1 else None), (0 if several else len(arguments))
    return (annotation if annotation in _DTYPES else None), None
