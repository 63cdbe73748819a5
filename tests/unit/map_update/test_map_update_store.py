"""What the store has acknowledged it has, once; what it could not store it has not acknowledged."""

import inspect
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
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.map_update.admission import Refusal
from camber.map_update.contribution import OBSERVATION, Contribution
from camber.map_update.store import FORMAT, Store, StoreError

NOW_NS = 1_400_000_000 * 1_000_000_000


def contribution(
    name: str, *, vehicle="v1", kind="upload", height_m=40.0, datum="WGS84", records=1
) -> Contribution:
    rows = np.zeros(records, OBSERVATION)
    rows["time_ns"] = NOW_NS
    rows["road_height_m"] = height_m
    return Contribution(
        vehicle=vehicle,
        kind=kind,
        id=name,
        datum=datum,
        map_version=1,
        epoch_year=2024.0,
        position_covariance_enu_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 4.0) if kind == "upload" else None,
        observations=rows,
    )


def take_all(_: Contribution) -> None:
    return None


def refuse_all(_: Contribution) -> Refusal:
    return Refusal("datum", "datum Tokyo, expected WGS84")


def refuse_tokyo(candidate: Contribution) -> Refusal | None:
    return refuse_all(candidate) if candidate.datum == "Tokyo" else None


def committed(store: Store, *contributions: Contribution, judge=take_all) -> list[str]:
    return [outcome.status for outcome in store.commit(contributions, NOW_NS, judge)]


def rows_of(path, columns="vehicle, kind, id"):
    with closing(sqlite3.connect(path)) as db:
        return db.execute(f"SELECT {columns} FROM contribution ORDER BY number").fetchall()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "state" / "uploads.sqlite"


@pytest.fixture
def store(path):
    with closing(Store(path, busy_s=0.01)) as store:
        yield store


def test_an_upload_is_stored_once_and_then_a_duplicate_also_after_a_restart(path, store):
    assert committed(store, contribution("u1")) == ["stored"]
    assert committed(store, contribution("u1")) == ["duplicate"]
    store.close()
    with closing(Store(path)) as again:
        assert committed(again, contribution("u1")) == ["duplicate"]
        assert again.counts() == (1, 1)


def test_a_repetition_within_one_group_is_a_duplicate(store):
    assert committed(store, contribution("u1"), contribution("u1")) == ["stored", "duplicate"]
    assert store.counts() == (1, 1)


def test_other_contents_under_a_stored_id_are_refused_and_what_is_stored_stays(path, store):
    committed(store, contribution("u1", height_m=40.0))
    (outcome,) = store.commit([contribution("u1", height_m=41.0)], NOW_NS, take_all)
    assert outcome.status == "refused"
    assert outcome.refusal is not None
    assert outcome.refusal.code == "id_reused"
    assert "u1" in outcome.refusal.text
    with closing(sqlite3.connect(path)) as db:
        assert db.execute("SELECT road_height_m FROM observation").fetchall() == [(40.0,)]


def test_ids_of_two_vehicles_and_of_uploads_and_batches_are_apart(path, store):
    same = [contribution("x"), contribution("x", vehicle="v2"), contribution("x", kind="batch")]
    assert committed(store, *same) == ["stored"] * 3
    assert rows_of(path) == [("v1", "upload", "x"), ("v2", "upload", "x"), ("v1", "batch", "x")]


def test_a_refused_upload_is_not_stored_and_the_others_of_its_group_are(store):
    group = [contribution("u1"), contribution("bad", datum="Tokyo"), contribution("u2")]
    assert committed(store, *group, judge=refuse_tokyo) == ["stored", "refused", "stored"]
    assert store.counts() == (2, 2)
    assert committed(store, contribution("bad")) == ["stored"]


def test_what_is_stored_stays_a_duplicate_when_it_would_be_refused_today(store):
    committed(store, contribution("u1"))
    assert committed(store, contribution("u1"), judge=refuse_all) == ["duplicate"]


def test_a_batch_is_one_ledger_row_and_all_its_observations_once(path, store):
    batch = contribution("b1", kind="batch", records=1000)
    assert committed(store, batch) == ["stored"]
    assert committed(store, batch) == ["duplicate"]
    assert store.counts() == (1, 1000)
    with closing(sqlite3.connect(path)) as db:
        assert db.execute("SELECT count(*), count(DISTINCT contribution) FROM observation").fetchone() == (
            1000,
            1,
        )
    assert rows_of(path, "epoch_year, position_covariance_enu_m2") == [(2024.0, None)]


def test_numbers_come_back_bit_for_bit(path, store):
    rng = np.random.default_rng(3)
    sent = contribution("b1", kind="batch", records=200)
    for name in OBSERVATION.names or ():
        limits = {"verdict": 4, "fix_quality": 8}.get(name, 2**62)
        integers = OBSERVATION[name].kind in "iu"
        sent.observations[name] = rng.integers(0, limits, 200) if integers else rng.normal(0.0, 1e3, 200)
    committed(store, sent)
    with closing(sqlite3.connect(path)) as db:
        rows = db.execute(
            f"SELECT {', '.join(OBSERVATION.names or ())} FROM observation ORDER BY rowid"
        ).fetchall()
    assert np.array(rows, OBSERVATION).tobytes() == sent.observations.tobytes()


def test_a_locked_file_acknowledges_nothing_and_works_afterwards(path, store):
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(StoreError, match=r"uploads\.sqlite.*locked"):
            committed(store, contribution("u1"))
        other.execute("ROLLBACK")
    assert store.counts() == (0, 0)
    assert committed(store, contribution("u1")) == ["stored"]


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


def test_a_fault_in_the_middle_of_a_group_stores_nothing_of_it(store):
    def judge(candidate: Contribution) -> None:
        if candidate.id == "u2":
            raise KeyError("a fault")

    with pytest.raises(KeyError):
        committed(store, contribution("u1"), contribution("u2"), judge=judge)
    assert store.counts() == (0, 0)
    assert committed(store, contribution("u1")) == ["stored"]


def test_a_file_of_a_later_version_or_no_database_is_an_error_that_names_it(path):
    path.parent.mkdir()
    with closing(sqlite3.connect(path)) as db:
        db.execute(f"PRAGMA user_version = {FORMAT + 1}")
    with pytest.raises(StoreError, match=r"uploads\.sqlite: format 2, expected at most 1"):
        Store(path)
    path.write_bytes(b"not a database" * 1000)
    with pytest.raises(StoreError, match=r"uploads\.sqlite"):
        Store(path)
    assert path.read_bytes() == b"not a database" * 1000


@pytest.mark.parametrize("seed", range(40))
def test_in_a_damaged_file_what_is_acknowledged_is_there(tmp_path, seed):
    rng = random.Random(seed)
    path = tmp_path / "uploads.sqlite"
    with closing(Store(path)) as store:
        committed(store, *(contribution(f"old{n}") for n in range(300)))
    data = bytearray(path.read_bytes())
    for _ in range(rng.choice((1, 10, 100))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.write_bytes(data)
    acknowledged = Counter()
    try:
        with closing(Store(path)) as store:
            for n in range(50):
                if committed(store, contribution(f"new{n}")) == ["stored"]:
                    acknowledged[f"new{n}"] += 1
    except StoreError as error:
        assert "uploads.sqlite" in str(error)  # noqa: PT017  (either is right)
    if acknowledged:
        with closing(sqlite3.connect(path)) as db:
            db.text_factory = lambda raw: raw.decode("utf-8", "replace")
            found = Counter(
                row[0] for row in db.execute("SELECT id FROM contribution NOT INDEXED WHERE number > 0")
            )
        assert {name: found[name] for name in acknowledged} == dict(acknowledged)


WRITER = f"""
import os, random, sys
from pathlib import Path
import numpy as np
from camber.map_update.contribution import OBSERVATION, Contribution
from camber.map_update.store import Store

NOW_NS = {NOW_NS}
{inspect.getsource(contribution)}
rng, first = random.Random(int(sys.argv[3])), int(sys.argv[2])
store, number = Store(Path(sys.argv[1])), first
while True:
    names = [f"u{{n}}" for n in range(number, number + rng.choice((1, 5, 40)))]
    names.append(f"u{{rng.randrange(first, number + 1)}}")  # a repetition
    outcomes = store.commit([contribution(n) for n in names], NOW_NS, lambda _: None)
    os.write(1, "".join(f"{{n}} {{o.status}}\\n" for n, o in zip(names, outcomes)).encode())
    number += len(names) - 1
"""


def test_a_store_killed_at_any_moment_has_everything_it_acknowledged_once(path):
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
        found = [name for _, _, name in rows_of(path)]
        assert len(found) == len(set(found))
        assert set(acknowledged) <= set(found)
        assert set(acknowledged.values()) == {1}
        with closing(sqlite3.connect(path)) as db:
            assert db.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            assert db.execute("SELECT count(*) FROM observation").fetchone() == (len(found),)
    with closing(Store(path)) as store:
        assert set(committed(store, *(contribution(name) for name in acknowledged))) == {"duplicate"}
    assert len(acknowledged) > 300


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.lists(
        st.lists(
            st.tuples(
                st.sampled_from("ab"), st.sampled_from("xyz"), st.sampled_from([1.0, 2.0]), st.booleans()
            ),
            max_size=5,
        ),
        max_size=8,
    )
)
def test_any_sequence_of_groups_stores_the_first_accepted_content_of_each_id_once(tmp_path_factory, groups):
    path = tmp_path_factory.mktemp("store") / "uploads.sqlite"
    model: dict[tuple[str, str], float] = {}
    with closing(Store(path)) as store:
        for group in groups:
            wanted = []
            for vehicle, name, height_m, bad in group:
                known = model.get((vehicle, name))
                if known is None and not bad:
                    model[vehicle, name] = height_m
                    wanted.append("stored")
                else:
                    wanted.append("duplicate" if known == height_m and not bad else "refused")
            members = [
                contribution(name, vehicle=vehicle, height_m=height_m, datum="Tokyo" if bad else "WGS84")
                for vehicle, name, height_m, bad in group
            ]
            assert committed(store, *members, judge=refuse_tokyo) == wanted
        assert store.counts() == (len(model), len(model))
