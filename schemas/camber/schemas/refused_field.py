"""The first field that a model refuses, for one clear line: the others mostly follow from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import ValidationError


@dataclass(frozen=True, slots=True, kw_only=True)
class RefusedField:
    """Its name, such as `points.3.x`, what is expected, and its value; None: a table or an array."""

    name: str
    expected: str
    value: str | None

    def __str__(self) -> str:
        return f"{self.name}: {self.expected}"


def first_refused(error: ValidationError, *, whole: str = "content") -> RefusedField:
    """Return the first field of an error; `whole` is its name where none of its fields alone is refused."""
    first = error.errors(include_url=False, include_context=False)[0]
    value = first["input"]
    return RefusedField(
        name=".".join(map(str, first["loc"])) or whole,
        expected=first["msg"],
        value=None if isinstance(value, np.ndarray | dict) else str(value),
    )
