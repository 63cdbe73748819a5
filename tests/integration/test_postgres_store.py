"""The store in PostgreSQL: many at once, a server that goes away, one that may not be used, a disk that is full."""

import re
import resource
import threading
import time
from contextlib import closing

import numpy as np
import pytest

from camber.map_update.contribution import OBSERVATION
from camber.map_update.stores import postgres_store
from camber.map_update.stores.postgres_store import PostgresStore
from camber.map_update.stores.store import FusionStep, StoreError
from support.contributions import NOW_NS, committed, contribution, names_in, random_batch, take_all
from support.databases import PostgresServer, needs_postgres, running
from support.running import free_port, wait_until

pytestmark = needs_postgres


@pytest.fixture(scope="module")
def server():
    server = PostgresServer()
    with running(server):
        yield server


@pytest.fixture
def address(server):
    return server.new_database()


def opened(address, **options):
    return closing(PostgresStore(address, **{"limit_s": 10.0, **options}))


def test_a_reader_that_follows_several_writers_leaves_none_out(address):
    """Transactions overtake one another; the ledger's numbers do not."""
    writers, groups = 3, 25

    def write(k: int) -> None:
        with opened(address) as store:
            for n in range(groups):
                committed(store, *(contribution(f"w{k}.{n}.{m}") for m in range(1 + n % 3)))

    with opened(address) as reader:
        threads = [threading.Thread(target=write, args=(k,)) for k in range(writers)]
        for thread in threads:
            thread.start()
        cursor, numbers, seen = 0, [], []
        while True:
            over = not any(thread.is_alive() for thread in threads)
            result = reader.observations_after(cursor, 7)
            cursor = result.cursor
            numbers += [entry.number for entry in result.entries]
            seen += [entry.id for entry in result.entries]
            if over and not result.entries:
                break
        for thread in threads:
            thread.join()
    expected = {f"w{k}.{n}.{m}" for k in range(writers) for n in range(groups) for m in range(1 + n % 3)}
    assert numbers == list(range(1, len(expected) + 1))
    assert set(seen) == expected


def test_of_two_that_store_the_same_at_the_same_time_one_hears_duplicate(address):
    heard: list[str] = []

    def write() -> None:
        with opened(address) as store:
            for n in range(30):
                heard.extend(committed(store, contribution(f"u{n}")))

    threads = [threading.Thread(target=write) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(heard) == ["duplicate"] * 30 + ["stored"] * 30


def test_groups_across_partitions_are_read_whole_and_a_forgotten_partition_is_gone(
    server, address, monkeypatch
):
    monkeypatch.setattr(postgres_store, "PARTITION", 4)
    rng = np.random.default_rng(1)
    sent = [random_batch(f"b{n}", 3, rng) for n in range(11)]
    with opened(address) as store:
        assert committed(store, *sent[:3]) == ["stored"] * 3
        assert committed(store, *sent[3:]) == ["stored"] * 8
        result = store.observations_after(0, 1000)
        assert result.rows.tobytes() == b"".join(batch.observations.tobytes() for batch in sent)
        store.advance(store.progress(), FusionStep(cursor=9))
        assert store.forget(NOW_NS + 1) == 9
        assert [h.id for h in names(store)] == ["b9", "b10"]
        schema = address.rpartition("=")[2]
        tables = server.execute(f"SELECT tablename FROM pg_tables WHERE schemaname = '{schema}'")
        assert {t for (t,) in tables if t.startswith("observation_")} == {"observation_2"}
        assert committed(store, *sent) == ["duplicate"] * 11


def names(store):
    result = store.observations_after(0, 1000)
    return [result.entries[n] for n in np.unique(result.entry_of)]


def test_a_server_that_is_killed_acknowledges_nothing_loses_nothing_and_is_found_again():
    server = PostgresServer()
    with running(server):
        address = f"{server.new_database()}&user=camber"
        with opened(address, password="hush") as store:
            assert committed(store, contribution("u1")) == ["stored"]
            server.end()
            complaints = []
            for _ in range(3):
                with pytest.raises(StoreError) as complaint:
                    committed(store, contribution("u2"))
                complaints.append(str(complaint.value))
            assert all(
                text.startswith(f"postgresql://127.0.0.1:{server.port}/postgres: ") for text in complaints
            )
            assert not any("hush" in text or "camber" in text for text in complaints)
            server.start()

            def stored():
                try:
                    return committed(store, contribution("u1"), contribution("u2"))
                except StoreError:
                    return None

            result = wait_until(stored, timeout_s=20.0, why="the store does not come back")
            assert result == ["duplicate", "stored"]


def test_a_server_that_is_not_there_yet_is_waited_for():
    with opened(f"postgresql://camber@127.0.0.1:{free_port()}/postgres", limit_s=1.0) as store:
        began = time.process_time()
        for _ in range(200):
            with pytest.raises(StoreError, match=r"127\.0\.0\.1"):
                store.check()
        assert time.process_time() - began < 1.0  # it does not try each time


def test_a_full_disk_acknowledges_nothing_of_the_group_and_keeps_what_was_stored():
    server = PostgresServer()
    batches = [contribution(f"b{n}", kind="batch", records=20_000) for n in range(16)]
    done = 0
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with running(server):
        address = server.new_database()
        server.end()
        # The write-ahead log has files of 16 MB; a table may not have more than a little over that.
        resource.setrlimit(resource.RLIMIT_FSIZE, (17 << 20, hard))
        try:
            server.start()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

        def fill() -> None:
            nonlocal done
            for batch in batches:
                committed(store, batch)
                done += 1

        with opened(address) as store:
            with pytest.raises(StoreError, match="File too large"):
                fill()
            assert done > 0
            server.end()
            server.start()
            result = wait_until(lambda: again(store, batches), timeout_s=20.0, why="no room after all")
            assert result == ["duplicate"] * done + ["stored"] * (16 - done)
            assert store.counts() == (16, 16 * 20_000)


def again(store, batches):
    try:
        return committed(store, *batches)
    except StoreError:
        return None


@pytest.mark.parametrize(
    ("statement", "complaint"),
    [
        ("UPDATE layout SET descr = '1' WHERE name = 'format'", "format 1, expected 2"),
        ("UPDATE layout SET descr = '[]' WHERE name = 'vote'", r"table vote is of another layout: \[\]"),
        ("DROP TABLE layout", "its table contribution is not Camber's"),
    ],
)
def test_a_database_of_another_version_or_of_others_is_refused(server, address, statement, complaint):
    with opened(address):
        pass
    server.execute(f"SET search_path TO {address.rpartition('=')[2]}", statement)
    with pytest.raises(StoreError, match=complaint):
        PostgresStore(address)


def test_a_server_that_does_not_flush_is_refused():
    server = PostgresServer()
    with (server.data / "postgresql.conf").open("a") as file:
        file.write("fsync = off\n")
    with running(server), pytest.raises(StoreError, match="fsync is off"):
        PostgresStore(server.address())


def test_a_failing_check_leaves_nothing_behind_and_the_connection_usable(address):
    def refusal_of(_):
        raise KeyError("a fault")

    with opened(address) as store:
        with pytest.raises(KeyError):
            committed(store, contribution("u1"), refusal_of=refusal_of)
        assert names_in(store) == []
        assert [o.status for o in store.commit([contribution("u1")], NOW_NS, take_all)] == ["stored"]


def test_tables_can_be_asked_with_sql(server, address):
    batches = [random_batch(f"b{n}", 1 + 40 * n, np.random.default_rng(n)) for n in range(3)]
    batches[0].observations["road_height_m"] = -0.0
    with opened(address) as store:
        committed(store, *batches)
    schema = re.escape(address.rpartition("=")[2])
    rows = server.execute(
        f"SELECT id, observation.* FROM {schema}.contribution"
        f" JOIN {schema}.observation ON contribution = number ORDER BY number, time_ns"
    )
    assert tuple(rows[0].keys()) == ("id", "contribution", *OBSERVATION.names)
    expected = [
        (batch.id, n, *row) for n, batch in enumerate(batches, 1) for row in batch.observations.tolist()
    ]
    assert [tuple(row) for row in rows] == expected
