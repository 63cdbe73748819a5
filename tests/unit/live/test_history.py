"""History: a ring that any number of browsers read, each from where it stands."""

from __future__ import annotations

import json

import numpy as np

from camber.live.history import Cursor, History, TableLayout

LAYOUTS = (
    TableLayout(name="verdict", exact=("t", "lat"), rest=("h",)),
    TableLayout(name="pose", exact=("t",), rest=("yaw", "speed", "basis")),
)


def parsed(data: bytes) -> dict[str, np.ndarray]:
    """Table and column → values, read as the page reads them."""
    length = int.from_bytes(data[:4], "little")
    header = json.loads(data[4 : 4 + length])
    offset, columns = 4 + length, {}
    layouts = {layout.name: layout for layout in LAYOUTS}
    for table in header["tables"]:
        layout = layouts[table["name"]]
        for names, dtype in ((layout.exact, np.float64), (layout.rest, np.float32)):
            assert offset % 8 == 0
            for name in names:
                columns[f"{table['name']}.{name}"] = np.frombuffer(data, dtype, table["rows"], offset)
                offset += table["rows"] * np.dtype(dtype).itemsize
            offset += -offset % 8
    assert offset == len(data)
    return columns


def filled(rows: int, capacity: int = 100) -> History:
    history = History(LAYOUTS, capacity)
    for k in range(rows):
        history.append("verdict", (float(k), 0.1 * k), (2.0 * k,), f"text {k}")
    return history


def test_a_browser_gets_every_row_once() -> None:
    history, cursor, seen = filled(7), filled(0).start(), []
    for k in range(7, 12):
        data, cursor = history.batch(cursor, 3)
        assert data is not None
        seen += parsed(data)["verdict.t"].tolist()
        history.append("verdict", (float(k), 0.0), (0.0,))
    while (batch := history.batch(cursor, 3))[0] is not None:
        seen += parsed(batch[0])["verdict.t"].tolist()
        cursor = batch[1]
    assert seen == [float(k) for k in range(12)]
    assert cursor == history.cursor()


def test_columns_are_what_was_appended() -> None:
    history = filled(3)
    history.append("pose", (5.0,), (1.0, float("nan"), 3.0))
    data, _ = history.batch(history.start(), 10)
    assert data is not None
    columns = parsed(data)
    np.testing.assert_allclose(columns["verdict.lat"], [0.0, 0.1, 0.2])
    np.testing.assert_allclose(columns["verdict.h"], [0.0, 2.0, 4.0])
    np.testing.assert_allclose(columns["pose.speed"], [np.nan])
    np.testing.assert_allclose(columns["pose.basis"], [3.0])


def test_a_slow_browser_misses_what_the_ring_has_no_more() -> None:
    history = filled(250, capacity=100)
    data, cursor = history.batch(history.start(), 1000)
    assert data is not None
    assert parsed(data)["verdict.t"].tolist() == [float(k) for k in range(150, 250)]
    assert cursor.rows == (250, 0)


def test_texts_go_with_their_rows() -> None:
    history = filled(250, capacity=100)
    assert history.text(0, 150) == "text 150"
    assert history.text(0, 249) == "text 249"
    assert history.text(0, 149) is None
    assert history.text(0, 250) is None
    assert history.text(1, 150) is None


def test_a_row_that_comes_late_is_left_out_and_counted() -> None:
    history = filled(10)
    history.append("verdict", (8.0, 0.0), (0.0,))
    assert (history.late, history.generation) == (1, 0)
    assert history.cursor().rows == (10, 0)


def test_a_time_that_goes_back_begins_anew() -> None:
    history = filled(10)
    cursor = history.cursor()
    history.append("verdict", (1.0, 0.5), (7.0,), "again")
    data, cursor = history.batch(cursor, 10)
    assert data is not None
    assert parsed(data)["verdict.t"].tolist() == [1.0]
    assert cursor == Cursor(generation=1, rows=(1, 0))
    assert history.text(1, 0) == "again"


def test_a_number_beyond_float32_is_infinite() -> None:
    history = History(LAYOUTS, 10)
    history.append("verdict", (1.0, 1.0), (1e300,))
    data, _ = history.batch(history.start(), 10)
    assert data is not None
    assert np.isinf(parsed(data)["verdict.h"]).all()
