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


# A name that is too long is an OSError, as is a private folder.
@pytest.mark.parametrize("name", ["none.sqlite", "x" * 300 + "/uploads.sqlite"], ids=["none", "no access"])
def test_a_store_that_is_not_there_is_one_line_and_no_new_file(tmp_path, refused, name):
    path = tmp_path / name
    assert refused(main, path) == f"camber uploads: {path}: no such file"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "statements", "why"),
    [
        ("", [], "format 0, expected 2"),
        ("notes\n" * 1000, [], "not a database"),
        ("", ["CREATE TABLE cake (name TEXT)"], "format 0, expected 2"),
        ("", ["CREATE TABLE cake (name TEXT)", "PRAGMA user_version = 2"], "no such table: layout"),
        (
            "",
            ["CREATE TABLE contribution (number INTEGER)", "PRAGMA user_version = 1"],
            "format 1, expected 2",
        ),
    ],
    ids=["empty", "text", "another database", "another of this version", "earlier version"],
)
def test_what_is_no_store_of_this_version_stays_as_it_is(tmp_path, refused, content, statements, why):
    path = tmp_path / "uploads.sqlite"
    path.write_text(content)
    if statements:
        with closing(sqlite3.connect(path)) as db:
            for statement in statements:
                db.execute(statement)
    before = path.read_bytes()
    line = refused(main, path)
    assert line.startswith(f"camber uploads: {path}: ")
    assert why in line
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


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


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("postgresql://u:geheim@db.example/uploads", "no password in an address"),
        ("postgresql://u@db.example:port/uploads", "expected postgresql://user@host:port"),
        ("mysql://db.example/uploads", "expected postgresql://user@host:port"),
    ],
)
def test_an_address_is_judged_as_map_update_judges_it(address, why, refused):
    line = refused(main, address)
    assert why in line
    assert "geheim" not in line
