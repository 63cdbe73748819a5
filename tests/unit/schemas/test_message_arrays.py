"""Arrays of a message: of one dtype, one shape, finite, within range, and of lengths that go together."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import pytest
from pydantic import ValidationError

from camber.schemas.arrays import ArrayOf, arrays_of
from camber.schemas.base import Float64, Int32, Model


class Lines(Model):
    line: Annotated[Int32, ArrayOf("<i4", ("lines",), ge=0, le=9)]
    first: Annotated[Int32, ArrayOf("<i4", ("lines+1",), offsets_into="points")]
    point_m: Annotated[Float64, ArrayOf("<f8", ("points", 2))]
    weight: Annotated[Float64, ArrayOf("<f8", ("points",))] | None = None


def lines(**changes: Any) -> Lines:
    fields = {
        "line": np.array([4, 5], "<i4"),
        "first": np.array([0, 1, 3], "<i4"),
        "point_m": np.zeros((3, 2)),
        "weight": np.ones(3),
    }
    return Lines(**fields | changes)


def test_arrays_that_go_together_are_accepted() -> None:
    assert lines().first.tolist() == [0, 1, 3]
    assert lines(weight=None).weight is None
    none = np.zeros(0, "<i4")
    assert len(lines(line=none, first=np.zeros(1, "<i4"), point_m=np.zeros((0, 2)), weight=None).line) == 0


def test_optional_arrays_are_listed() -> None:
    assert [name for name, _ in arrays_of(Lines)] == ["line", "first", "point_m", "weight"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"weight": np.ones(2)}, "weight has 2 rows where point_m has 3 points"),
        ({"line": np.array([4], "<i4")}, "first has 3 rows where line has 1 lines"),
        ({"first": np.zeros(0, "<i4"), "line": np.zeros(0, "<i4")}, "first has 0 rows"),
        ({"first": np.array([0, 1, 2], "<i4")}, "first does not end at the 3 points"),
        ({"first": np.array([1, 2, 3], "<i4")}, "offsets from 0 that never fall"),
        ({"first": np.array([0, 4, 3], "<i4")}, "offsets from 0 that never fall"),
        ({"line": np.array([4, 10], "<i4")}, "at most 9, got 10"),
        ({"line": np.array([-1, 4], "<i4")}, "at least 0, got -1"),
        ({"line": np.array([4, 5], "<i8")}, "expected dtype <i4, got int64"),
        ({"line": np.array([4, 5], ">i4")}, "expected dtype <i4, got >i4"),
        ({"line": [4, 5]}, "expected an array of <i4"),
        ({"point_m": np.zeros((3, 3))}, "expected shape"),
        ({"point_m": np.zeros(6)}, "expected shape"),
        ({"point_m": np.full((3, 2), np.nan)}, "finite"),
        ({"weight": np.array([1, np.inf, 1])}, "finite"),
        ({"weight": np.ma.masked_array(np.ones(3), [0, 1, 0])}, "expected an array of <f8"),
    ],
)
def test_arrays_that_do_not_are_refused_with_what_was_expected(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        lines(**changes)


def test_an_array_that_others_may_write_to_is_copied() -> None:
    mine = np.ones(3)
    through_a_view = mine.view()
    through_a_view.flags.writeable = False
    for given in (mine, through_a_view):
        message = lines(weight=given)
        mine[0] = 7.0
        assert message.weight[0] == 1.0
        assert not message.weight.flags.writeable
        mine[0] = 1.0


def test_an_array_that_nobody_can_write_to_is_not_copied() -> None:
    first = lines()
    assert lines(weight=first.weight).weight is first.weight


@pytest.mark.parametrize(
    ("dtype", "shape"), [("<M8", ("n",)), ("|O8", ("n",)), (">f8", ("n",)), ("<f8", (1, 1, 1, 1))]
)
def test_a_kind_of_array_that_the_codec_cannot_carry_is_a_mistake_at_once(
    dtype: str, shape: tuple[Any, ...]
) -> None:
    with pytest.raises(ValueError, match="carries no arrays of"):
        ArrayOf(dtype, shape)
