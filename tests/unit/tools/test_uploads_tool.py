"""What the fleet's store holds can be read by people and other programs."""

import csv
import io
from contextlib import closing

from camber.map_update.sqlite_store import SqliteStore
from camber.tools.uploads import main
from support.contributions import committed, contribution


def rows(capsys):
    return list(csv.DictReader(io.StringIO(capsys.readouterr().out)))


def test_contributions_and_records_come_as_csv(tmp_path, capsys):
    path = tmp_path / "uploads.sqlite"
    with closing(SqliteStore(path)) as store:
        committed(store, contribution("u1"), contribution("b1", kind="batch", records=3, height_m=41.5))
    assert main([str(path)]) == 0
    assert [(row["id"], row["kind"], row["records"]) for row in rows(capsys)] == [
        ("u1", "upload", "1"),
        ("b1", "batch", "3"),
    ]
    assert main([str(path), "--records"]) == 0
    found = rows(capsys)
    assert [row["id"] for row in found] == ["u1", "b1", "b1", "b1"]
    assert [float(row["road_height_m"]) for row in found] == [40.0, 41.5, 41.5, 41.5]
    assert {row["verdict"] for row in found} == {"confirmed"}


def test_a_store_that_is_not_there_is_one_line_and_no_new_file(tmp_path, capsys):
    path = tmp_path / "none.sqlite"
    assert main([str(path)]) == 2
    assert capsys.readouterr().err == f"camber uploads: {path}: no such file\n"
    assert not path.exists()
