"""The first field that a model refuses: its name, what is expected, its value."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from camber.schemas.refused_field import RefusedField, first_refused


class _Point(BaseModel):
    x: float = Field(ge=0.0)


class _Cloud(BaseModel):
    model_config = ConfigDict(arbitrary_types_allowed=True)

    points: list[_Point] = []
    name: str = "cloud"
    ranges: np.ndarray[Any, Any] | None = None

    @model_validator(mode="after")
    def _is_named(self) -> Self:
        if not self.name:
            raise ValueError("a name expected")
        return self


def _refused(**values: Any) -> RefusedField:
    with pytest.raises(ValidationError) as caught:
        _Cloud(**values)
    return first_refused(caught.value, whole="cloud")


def test_a_nested_field_is_named_by_its_path_with_its_value() -> None:
    field = _refused(points=[{"x": 1.0}, {"x": -2.5}, {"x": -3.5}])
    assert field == RefusedField(
        name="points.1.x", expected="Input should be greater than or equal to 0", value="-2.5"
    )
    assert str(field) == "points.1.x: Input should be greater than or equal to 0"


def test_an_error_of_the_whole_has_the_name_that_it_is_given() -> None:
    assert str(_refused(name="")) == "cloud: Value error, a name expected"


@pytest.mark.parametrize("values", [{"name": np.zeros(9)}, {"points": {"x": 1.0}}])
def test_a_table_or_an_array_is_not_shown(values: dict[str, Any]) -> None:
    assert _refused(**values).value is None
