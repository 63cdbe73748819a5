"""What the fleet's store holds can be read by people and other programs."""

import csv
import io
import sqlite3
from contextlib import closing

import pytest

from camber.map_update.stores.sqlite_store import SqliteStore
from camber.tools.operate.uploads import main
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
    result = rows(capsys)
    assert [row["id"] for row in result] == ["u1", "b1", "b1", "b1"]
    assert [float(row["road_height_m"]) for row in result] == [40.0, 41.5, 41.5, 41.5]
    assert {row["verdict"] for row in result} == {"confirmed"}


def test_a_store_that_is_not_there_is_one_line_and_no_new_file(tmp_path, capsys):
    path = tmp_path / "none.sqlite"
    assert main([str(path)]) == 2
    assert capsys.readouterr().err == f"camber uploads: {path}: no such file\n"
    assert not path.exists()


def refusal(path, capsys):
    """The error for a file that is no store of this version, which stays as it is."""
    before = path.read_bytes()
    assert main([str(path)]) == 2
    assert path.read_bytes() == before
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith(f"camber uploads: {path}: ")
    assert output.err.count("\n") == 1
    return output.err


def test_what_is_no_store_does_not_become_one(tmp_path, capsys):
    empty = tmp_path / "notes.txt"
    empty.touch()
    assert "format 0, expected 2" in refusal(empty, capsys)
    text = tmp_path / "text.txt"
    text.write_text("notes\n" * 1000)
    assert "not a database" in refusal(text, capsys)
    foreign = tmp_path / "other.db"
    with closing(sqlite3.connect(foreign)) as db:
        db.execute("CREATE TABLE cake (name TEXT)")
    assert "format 0, expected 2" in refusal(foreign, capsys)
    with closing(sqlite3.connect(foreign)) as db:
        db.execute("PRAGMA user_version = 2")
    assert "no such table: layout" in refusal(foreign, capsys)
    assert {path.name for path in tmp_path.iterdir()} == {"notes.txt", "text.txt", "other.db"}


def test_a_store_of_an_earlier_version_stays_of_that_version(tmp_path, capsys):
    path = tmp_path / "uploads.sqlite"
    with closing(sqlite3.connect(path)) as db:
        db.execute("CREATE TABLE contribution (number INTEGER PRIMARY KEY)")
        db.execute("PRAGMA user_version = 1")
    assert "format 1, expected 2" in refusal(path, capsys)


def test_a_store_in_use_is_read_and_stays_as_it_is(tmp_path, capsys):
    path = tmp_path / "uploads.sqlite"
    with closing(SqliteStore(path)) as store:
        committed(store, contribution("u1"))
        before = path.read_bytes()
        assert main([str(path)]) == 0
        assert [row["id"] for row in rows(capsys)] == ["u1"]
        assert path.read_bytes() == before
        committed(store, contribution("u2"))
    assert main([str(path)]) == 0
    assert [row["id"] for row in rows(capsys)] == ["u1", "u2"]


def test_where_we_may_not_look_there_is_no_file(tmp_path, capsys):
    path = (
        tmp_path / ("x" * 300) / "uploads.sqlite"
    )  # as a private folder, a name that is too long is an OSError
    assert main([str(path)]) == 2
    assert capsys.readouterr().err == f"camber uploads: {path}: no such file\n"


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("postgresql://u:geheim@db.example/uploads", "no password in an address"),
        ("postgresql://u@db.example:port/uploads", "expected postgresql://user@host:port"),
        ("mysql://db.example/uploads", "expected postgresql://user@host:port"),
    ],
)
def test_an_address_is_judged_as_map_update_judges_it(address, why, capsys):
    assert main([address]) == 2
    output = capsys.readouterr().err
    assert why in output
    assert "geheim" not in output
    assert output.count("\n") == 1
