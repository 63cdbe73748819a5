"""Truth tables: round trip, further columns of a simulator, errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camber.formats.drive.truth_csv import TruthTable, read_truth, write_truth
from camber.formats.errors import FormatError

N = 4


def table(**more: np.ndarray) -> TruthTable:
    rng = np.random.default_rng(3)
    return TruthTable(
        time_ns=1_400_000_000_000_000_000 + np.arange(N) * 100_000_000,
        latitude_rad=0.6 + rng.normal(0.0, 1e-6, N),
        longitude_rad=2.4 + rng.normal(0.0, 1e-6, N),
        height_m=rng.normal(40.0, 1.0, N),
        roll_rad=rng.normal(0.0, 0.02, N),
        pitch_rad=rng.normal(0.0, 0.02, N),
        yaw_rad=rng.uniform(-3.0, 3.0, N),
        velocity_enu_m_s=rng.normal(0.0, 5.0, (N, 3)),
        fix_state=np.array([0, 1, 2, 0], np.int8),
        more=more,
    )


def test_a_written_table_is_read_back(tmp_path: Path) -> None:
    more = {
        "road_height_m": np.array([38.123456, 38.5, np.nan, -0.25]),
        "link_id": np.array([7.0, 7.0, 8.0, 123456789.0]),
    }
    truth = table(**more)
    write_truth(tmp_path / "truth.csv", truth)
    back = read_truth(tmp_path / "truth.csv", "camber")
    assert np.array_equal(back.time_ns, truth.time_ns)
    assert np.array_equal(back.fix_state, truth.fix_state)
    assert np.allclose(back.latitude_rad, truth.latitude_rad, rtol=0, atol=1e-12)
    assert np.allclose(back.height_m, truth.height_m, rtol=0, atol=1e-5)
    assert np.allclose(back.yaw_rad, truth.yaw_rad, rtol=0, atol=1e-8)
    assert list(back.more) == list(more)
    for name, column in more.items():
        assert np.array_equal(back.more[name], column, equal_nan=True), name
    assert np.array_equal(back.rows(slice(1, 3)).more["link_id"], [7.0, 8.0])


def test_without_more_columns_the_file_is_as_it_always_was(tmp_path: Path) -> None:
    write_truth(tmp_path / "truth.csv", table())
    assert (tmp_path / "truth.csv").read_text().splitlines()[0].endswith("velocity_up_m_s,fix_wrong")
    assert read_truth(tmp_path / "truth.csv", "camber").more == {}


@pytest.mark.parametrize("name", ["time_ns", "Road height", "", "9lives"])
def test_a_column_that_is_there_already_or_is_no_name_is_not_written(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="expected new names"):
        write_truth(tmp_path / "truth.csv", table(**{name: np.zeros(N)}))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("road_height_m", "time_ns", "header"),
        ("road_height_m", "Road", "header"),
        (",38.5\n", ",nan\n", "truth.csv:3: road_height_m"),
        (",38.5\n", ",high\n", "truth.csv:3: road_height_m"),
        (",38.5\n", ",inf\n", "truth.csv:3: road_height_m"),
        (",38.5\n", "\n", "truth.csv:3: columns"),
    ],
)
def test_an_invalid_further_column_is_one_clear_error(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "truth.csv"
    write_truth(path, table(road_height_m=np.array([38.0, 38.5, np.nan, 39.0])))
    text = path.read_text().replace("38.500000", "38.5")
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FormatError) as refused:
        read_truth(path, "camber")
    assert message in str(refused.value)
