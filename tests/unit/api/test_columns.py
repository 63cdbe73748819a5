"""Messages as columns: every value is there again, and what is absent differs from what is zero."""

import math

import numpy as np
import pytest

import camber
from camber.schemas.base import Message
from camber.schemas.integrity import Position, Verdict
from support.judging import at, fix, pose

FIRST = Verdict(time_ns=at(0), fix_id=None, verdict="unknown", reason="starting")
SECOND = Verdict(
    time_ns=at(1),
    fix_id=2**62,
    verdict="confirmed",
    reason="height_agrees",
    evidence=("height", "position"),
    height_difference_m=0.0,
    position_difference_m=(0.5, -0.25),
)


def test_each_field_is_a_column_of_its_type():
    columns = camber.Columns.of_messages(Verdict, [FIRST, SECOND])
    assert columns.rows == 2
    assert columns["time_ns"].tolist() == [at(0), at(1)]
    assert columns["verdict"].tolist() == ["unknown", "confirmed"]
    assert columns["evidence"].tolist() == ["", "height position"]
    assert columns["fix_id"].tolist() == [-1, 2**62]
    assert math.isnan(columns["height_difference_m"][0])
    assert columns["height_difference_m"][1] == 0.0
    assert np.isnan(columns["position_difference_m"][0]).all()
    assert columns["position_difference_m"][1].tolist() == [0.5, -0.25]


def test_truth_values_stay_truth_values():
    positions = [
        Position(time_ns=at(k), source="none", usable=usable, alert_limit_m=1.5)
        for k, usable in enumerate((False, True))
    ]
    usable = camber.Columns.of_messages(Position, positions)["usable"]
    assert usable.dtype == np.bool_
    assert usable.tolist() == [False, True]


@pytest.mark.parametrize("message", [FIRST, SECOND, fix(0), pose(0)])
def test_without_messages_the_columns_and_their_types_are_the_same(message: Message):
    some = camber.Columns.of_messages(type(message), [message])
    none = camber.Columns.of_messages(type(message), [])
    assert none.rows == 0
    assert {name: (column.dtype.kind, column.shape[1:]) for name, column in none.items()} == {
        name: (column.dtype.kind, column.shape[1:]) for name, column in some.items()
    }


def test_messages_within_messages_are_left_out():
    assert "road" not in camber.Columns.of_messages(type(pose(0)), [pose(0)])


def test_a_data_frame_has_a_column_for_each_component():
    frame = camber.Columns.of_messages(Verdict, [FIRST, SECOND]).to_dataframe()
    assert len(frame) == 2
    assert frame["position_difference_m_1"].tolist()[1] == -0.25
    assert frame["verdict"].tolist() == ["unknown", "confirmed"]


def test_columns_of_different_lengths_are_refused():
    with pytest.raises(ValueError, match=r"lengths \[1, 2\]"):
        camber.Columns({"a": np.zeros(1), "b": np.zeros(2)})
