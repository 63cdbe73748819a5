"""Observations of roads in a file are read as the batches they are, or refused with the line that is wrong."""

import csv
import tracemalloc

import numpy as np
import pytest

from camber.formats.drive.uploads_csv import COLUMNS, MOST_RECORDS, check_uploads
from camber.formats.errors import FormatError
from support.tree import ROOT

EXAMPLE = ROOT / "examples" / "uploads.csv"


def read_uploads(path):
    checked = check_uploads(path)
    batches = list(checked.batches())
    assert len(batches) == checked.batch_count
    return batches


def write(path, rows, columns=("id", *COLUMNS)):
    with path.open("w", newline="") as file:
        out = csv.DictWriter(file, columns, extrasaction="ignore")
        out.writeheader()
        out.writerows(rows)
    return path


def row(**changes):
    with EXAMPLE.open(newline="") as file:
        return {**next(csv.DictReader(file)), **changes}


def test_the_example_is_one_batch_a_vehicle():
    batches = read_uploads(EXAMPLE)
    assert [(batch.vehicle, batch.batch_id) for batch in batches] == [
        (f"car-{n}", f"monday-{n}") for n in (1, 2, 3)
    ]
    first = batches[0]
    assert (first.datum, first.map_version, first.epoch_year) == ("ITRF2014", 1, 2025.9)
    assert first.road_height_m.tolist() == [41.2, 41.22, 41.24, 41.26]
    assert first.time_ns == first.positioning_time_ns[-1] == 1447891221000000000
    assert (first.verdict.tolist(), first.fix_quality.tolist()) == ([0] * 4, [0] * 4)


def test_columns_come_in_any_order_and_others_are_ignored(tmp_path):
    columns = ("received_ns", *reversed(COLUMNS), "id", "kind")
    (batch,) = read_uploads(write(tmp_path / "a.csv", [row(kind="batch", received_ns="5")], columns))
    assert batch.surface_id.tolist() == [10]


def test_without_ids_the_content_names_the_batch(tmp_path):
    def id_of(name, **changes):
        (batch,) = read_uploads(write(tmp_path / name, [row(**changes)], COLUMNS))
        return batch.batch_id

    assert id_of("a.csv") == id_of("b.csv")
    assert id_of("a.csv") != id_of("c.csv", road_height_m="41.3")


def test_a_large_batch_becomes_several_with_numbered_ids(tmp_path):
    batches = read_uploads(
        write(tmp_path / "a.csv", [row(fix_id=str(n)) for n in range(2 * MOST_RECORDS + 1)])
    )
    assert [len(batch.fix_id) for batch in batches] == [MOST_RECORDS, MOST_RECORDS, 1]
    assert [batch.batch_id for batch in batches] == ["monday-1", "monday-1.1", "monday-1.2"]
    assert np.concatenate([batch.fix_id for batch in batches]).tolist() == list(range(2 * MOST_RECORDS + 1))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"fix_quality": "firm"}, "a.csv:3: fix_quality is 'firm', expected one of fixed, float"),
        ({"road_height_m": "nan"}, "a.csv:3: road_height_m is 'nan', expected a number"),
        ({"road_height_m": ""}, "a.csv:3: road_height_m is '', expected a number"),
        ({"fix_id": "-1"}, "a.csv:3: fix_id is '-1', expected an integer"),
        ({"vehicle": "a/b"}, "a.csv:3: vehicle is 'a/b', expected"),
        ({"epoch_year": "20"}, "a.csv:3: epoch_year is '20.0', expected"),
    ],
)
def test_an_error_names_its_line(tmp_path, changes, complaint):
    path = write(tmp_path / "a.csv", [row(), row(id="next", **changes)])
    with pytest.raises(FormatError) as caught:
        read_uploads(path)
    assert str(caught.value).startswith(complaint)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"a,b\n1,2\n", b'vehicle,"id\n', b"\x00\n\x00\n"])
def test_another_file_is_refused(tmp_path, content):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with pytest.raises(FormatError):
        read_uploads(path)


def test_a_file_that_changes_after_its_check_is_refused(tmp_path):
    path = write(tmp_path / "a.csv", [row()])
    checked = check_uploads(path)
    write(path, [row(road_height_m="41.3")])
    with pytest.raises(FormatError, match=r"a\.csv: the file, expected the content that was checked"):
        list(checked.batches())


def test_a_line_without_end_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text(",".join(COLUMNS) + "\n" + "1" * 10_000_000)
    with pytest.raises(FormatError, match="the row, expected at most 65536 characters"):
        check_uploads(tmp_path / "a.csv")


def test_memory_does_not_grow_with_the_file(tmp_path):
    def peak_bytes(count):
        path = write(tmp_path / "a.csv", (row_ | {"fix_id": str(n)} for n in range(count)))
        tracemalloc.start()
        try:
            for _ in check_uploads(path).batches():
                pass
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    row_ = row(id="")
    assert peak_bytes(4 * MOST_RECORDS) < 1.2 * peak_bytes(2 * MOST_RECORDS)


def test_a_file_without_rows_and_a_row_cut_short_are_refused(tmp_path):
    with pytest.raises(FormatError, match="at least one row"):
        read_uploads(write(tmp_path / "a.csv", []))
    path = write(tmp_path / "b.csv", [row()])
    path.write_text(path.read_text().rsplit(",", 2)[0] + "\n")
    with pytest.raises(FormatError, match=r"b\.csv:2: the row, expected"):
        read_uploads(path)
