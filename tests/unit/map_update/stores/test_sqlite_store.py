"""The store in a file: locked, full, damaged, of another version, killed."""

import inspect
import json
import os
import random
import resource
import signal
import sqlite3
import subprocess
import sys
from collections import Counter
from contextlib import closing

import numpy as np
import pytest

from camber.map_update.stores.sqlite_store import SqliteStore
from camber.map_update.stores.store import FORMAT, FusionStep, StoreError, ledger_row
from support.contributions import NOW_NS, committed, contribution, random_batch


def ids_in(path):
    with closing(sqlite3.connect(path)) as db:
        return [name for (name,) in db.execute("SELECT id FROM contribution ORDER BY number")]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "state" / "uploads.sqlite"


@pytest.fixture
def store(path):
    with closing(SqliteStore(path, busy_s=0.01)) as store:
        yield store


def test_a_full_disk_acknowledges_nothing_of_the_group_and_keeps_what_was_stored(path, store):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    stored = 0
    resource.setrlimit(resource.RLIMIT_FSIZE, (512 << 10, hard))

    def fill() -> None:
        nonlocal stored
        for number in range(10_000):
            committed(store, *(contribution(f"u{number}.{k}") for k in range(20)))
            stored += 20

    try:
        with pytest.raises(StoreError, match=r"uploads\.sqlite"):
            fill()
        assert stored > 0
        assert store.counts() == (stored, stored)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert committed(store, contribution("u0.0"), contribution("new")) == ["duplicate", "stored"]


def test_a_file_of_a_later_version_or_no_database_is_an_error_that_names_it(path):
    path.parent.mkdir()
    with closing(sqlite3.connect(path)) as db:
        db.execute(f"PRAGMA user_version = {FORMAT + 1}")
    with pytest.raises(StoreError, match=r"uploads\.sqlite: format 3, expected at most 2"):
        SqliteStore(path)
    path.write_bytes(b"not a database" * 1000)
    with pytest.raises(StoreError, match=r"uploads\.sqlite"):
        SqliteStore(path)
    assert path.read_bytes() == b"not a database" * 1000


@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_file_contains_what_it_acknowledges(tmp_path, seed):
    rng = random.Random(seed)
    path = tmp_path / "uploads.sqlite"
    with closing(SqliteStore(path)) as store:
        committed(store, *(contribution(f"old{n}") for n in range(300)))
    data = bytearray(path.read_bytes())
    for _ in range(rng.choice((1, 10, 100))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.write_bytes(data)
    acknowledged = Counter()
    try:
        with closing(SqliteStore(path)) as store:
            for n in range(50):
                if committed(store, contribution(f"new{n}")) == ["stored"]:
                    acknowledged[f"new{n}"] += 1
    except StoreError as error:
        assert "uploads.sqlite" in str(error)  # noqa: PT017  (either is right)
    if acknowledged:
        with closing(sqlite3.connect(path)) as db:
            db.text_factory = lambda raw: raw.decode("utf-8", "replace")
            result = Counter(
                row[0] for row in db.execute("SELECT id FROM contribution NOT INDEXED WHERE number > 0")
            )
        assert {name: result[name] for name in acknowledged} == dict(acknowledged)


WRITER = f"""
import os, random, sys
from pathlib import Path
import numpy as np
from camber.map_update.contribution import OBSERVATION, Contribution
from camber.map_update.stores.sqlite_store import SqliteStore

Kind = str

NOW_NS = {NOW_NS}
{inspect.getsource(contribution)}
rng, first = random.Random(int(sys.argv[3])), int(sys.argv[2])
store, number = SqliteStore(Path(sys.argv[1])), first
while True:
    names = [f"u{{n}}" for n in range(number, number + rng.choice((1, 5, 40)))]
    names.append(f"u{{rng.randrange(first, number + 1)}}")  # a repetition
    outcomes = store.commit([contribution(n) for n in names], NOW_NS, lambda _: None)
    os.write(1, "".join(f"{{n}} {{o.status}}\\n" for n, o in zip(names, outcomes)).encode())
    number += len(names) - 1
"""


def test_a_store_killed_at_any_moment_has_all_acknowledged_uploads_once(path):
    rng = random.Random(11)
    acknowledged: Counter[str] = Counter()
    for kill in range(10):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path), str(kill * 1_000_000), str(kill)],
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            text=True,
        )
        assert writer.stdout is not None
        lines = [writer.stdout.readline() for _ in range(rng.randrange(1, 500))]
        writer.send_signal(signal.SIGKILL)
        lines += writer.stdout.read().splitlines()
        writer.stdout.close()
        assert writer.wait() == -signal.SIGKILL
        acknowledged.update(line.split()[0] for line in lines if line.strip().endswith(" stored"))
        result = ids_in(path)
        assert len(result) == len(set(result))
        assert set(acknowledged) <= set(result)
        assert set(acknowledged.values()) == {1}
        with closing(sqlite3.connect(path)) as db:
            assert db.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            assert db.execute("SELECT count(*) FROM observation").fetchone() == (len(result),)
    with closing(SqliteStore(path)) as store:
        assert set(committed(store, *(contribution(name) for name in acknowledged))) == {"duplicate"}
    assert len(acknowledged) > 300


LEDGER_1 = """
CREATE TABLE contribution (
    number INTEGER PRIMARY KEY, vehicle TEXT NOT NULL, kind TEXT NOT NULL, id TEXT NOT NULL, digest BLOB NOT NULL,
    received_ns INTEGER NOT NULL, records INTEGER NOT NULL, datum TEXT NOT NULL, map_version INTEGER NOT NULL,
    epoch_year REAL NOT NULL, position_covariance_enu_m2 BLOB, UNIQUE (vehicle, kind, id)
)"""


def file_of_format_1(path, contributions):
    """As the first version of this program wrote it: a row of the database for each observation."""
    path.parent.mkdir()
    names = contributions[0].observations.dtype.names
    with closing(sqlite3.connect(path)) as db:
        db.execute(LEDGER_1)
        db.execute(
            f"CREATE TABLE observation (contribution INTEGER REFERENCES contribution, {', '.join(names)})"
        )
        for number, c in enumerate(contributions, 1):
            db.execute(
                f"INSERT INTO contribution VALUES (?{', ?' * 10})", ledger_row(number, c, c.digest(), NOW_NS)
            )
            for values in c.observations.tolist():
                db.execute(f"INSERT INTO observation VALUES (?{', ?' * len(names)})", (number, *values))
        db.execute("PRAGMA user_version = 1")
        db.commit()


def test_a_file_of_the_first_format_is_converted_with_its_content(path):
    rng = np.random.default_rng(8)
    sent = [random_batch(f"b{n}", 5 + n, rng) for n in range(4)]
    file_of_format_1(path, sent)
    with closing(SqliteStore(path)) as store:
        result = store.observations_after(0, 1000)
        assert result.rows.tobytes() == b"".join(batch.observations.tobytes() for batch in sent)
        assert committed(store, *sent, contribution("new")) == ["duplicate"] * 4 + ["stored"]
        assert store.progress() == (0, 0)
    with closing(SqliteStore(path)) as again:
        assert again.counts() == (5, 5 + 6 + 7 + 8 + 1)


def test_the_file_describes_its_layout_for_other_programs(path, store):
    sent = random_batch("b1", 20, np.random.default_rng(2))
    committed(store, sent)
    with closing(sqlite3.connect(path)) as db:
        (descr,) = db.execute("SELECT descr FROM layout WHERE name = 'observation'").fetchone()
        (rows,) = db.execute("SELECT rows FROM observation").fetchone()
    result = np.frombuffer(rows, np.dtype([tuple(field) for field in json.loads(descr)]))
    assert result.dtype.names == sent.observations.dtype.names
    assert result.tolist() == sent.observations.tolist()


def test_a_file_with_another_layout_is_refused(path, store):
    store.close()
    with closing(sqlite3.connect(path)) as db:
        db.execute("UPDATE layout SET descr = '[]' WHERE name = 'vote'")
        db.commit()
    with pytest.raises(StoreError, match=r"uploads\.sqlite: table vote is of another layout: \[\]"):
        SqliteStore(path)


def test_forgotten_observations_are_overwritten_in_the_file(path, store):
    sent = contribution("b1", kind="batch", records=300)
    sent.observations["road_height_m"] = 40.123456789
    mark = sent.observations["road_height_m"][:1].tobytes()
    committed(store, sent, contribution("u1"))
    store.advance(store.progress(), FusionStep(cursor=2))
    assert store.forget(NOW_NS + 1) == 2
    store.close()
    assert mark not in path.read_bytes()
