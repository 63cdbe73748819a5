"""Every store has once what it acknowledged, and acknowledged nothing that it could not store."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.map_update.contribution import Contribution
from camber.map_update.fusion.votes import VOTE
from camber.map_update.stores.postgres_store import PostgresStore
from camber.map_update.stores.sqlite_store import SqliteStore
from camber.map_update.stores.store import FusionStep, LedgerEntry, OvertakenError, Store
from support.contributions import (
    NOW_NS,
    committed,
    contribution,
    names_in,
    random_batch,
    refuse_all,
    refuse_tokyo,
    take_all,
)
from support.databases import PostgresServer, needs_postgres, running

Open = Callable[[], Store]


@pytest.fixture(scope="module")
def postgres() -> Iterator[PostgresServer]:
    server = PostgresServer()
    with running(server):
        yield server


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=needs_postgres)])
def database(request, tmp_path) -> Iterator[Open]:
    """Opens one database, empty at first, as often as it is called."""
    path = tmp_path / "state" / "uploads.sqlite"
    postgres = request.getfixturevalue("postgres") if request.param == "postgres" else None
    address = postgres.new_database() if postgres else ""
    with ExitStack() as ends:

        def opened() -> Store:
            # The limits are those of a machine with other things to do.
            store = PostgresStore(address, limit_s=10.0) if address else SqliteStore(path, busy_s=10.0)
            ends.callback(store.close)
            return store

        yield opened


@pytest.fixture
def store(database) -> Store:
    return database()


def test_an_upload_is_stored_once_and_then_a_duplicate_also_after_a_restart(database, store):
    assert committed(store, contribution("u1")) == ["stored"]
    assert committed(store, contribution("u1")) == ["duplicate"]
    store.close()
    again = database()
    assert committed(again, contribution("u1")) == ["duplicate"]
    assert again.counts() == (1, 1)


def test_other_content_under_a_stored_id_is_refused(store):
    committed(store, contribution("u1", height_m=40.0))
    (outcome,) = store.commit([contribution("u1", height_m=41.0)], NOW_NS, take_all)
    assert outcome.status == "refused"
    assert outcome.refusal is not None
    assert outcome.refusal.code == "id_reused"
    assert "u1" in outcome.refusal.text
    assert store.observations_after(0, 10).rows["road_height_m"].tolist() == [40.0]


def test_ids_are_per_vehicle_and_per_kind(store):
    same = [contribution("x"), contribution("x", vehicle="v2"), contribution("x", kind="batch")]
    assert committed(store, *same) == ["stored"] * 3
    assert names_in(store) == [("v1", "upload", "x"), ("v2", "upload", "x"), ("v1", "batch", "x")]


def test_a_stored_upload_is_a_duplicate_even_if_it_would_be_refused_now(store):
    committed(store, contribution("u1"))
    assert committed(store, contribution("u1"), refusal_of=refuse_all) == ["duplicate"]


def test_a_batch_is_one_ledger_row_and_all_its_observations_once(store):
    batch = contribution("b1", kind="batch", records=1000)
    assert committed(store, batch) == ["stored"]
    assert committed(store, batch) == ["duplicate"]
    assert store.counts() == (1, 1000)
    page = store.observations_after(0, 10_000)
    assert (len(page.entries), len(page.rows)) == (1, 1000)
    expected = {"number": page.cursor, "vehicle": "v1", "kind": "batch", "id": "b1", "received_ns": NOW_NS}
    assert page.entries[0] == LedgerEntry(**expected, datum="WGS84", map_version=1, epoch_year=2024.0)


def test_observations_are_read_back_bit_for_bit(store):
    rng = np.random.default_rng(3)
    sent = [random_batch(f"b{n}", int(rng.integers(1, 200)), rng) for n in range(7)]
    committed(store, *sent)
    result = store.observations_after(0, 10_000)
    assert result.rows.tobytes() == b"".join(batch.observations.tobytes() for batch in sent)
    assert result.entry_of.tolist() == [n for n, batch in enumerate(sent) for _ in batch.observations]


def test_rows_of_a_contribution_come_in_the_order_of_time(store):
    sent = contribution("b1", kind="batch", records=50)
    sent.observations[:] = sent.observations[::-1].copy()
    committed(store, sent, contribution("u1"))
    times = store.observations_after(0, 100).rows["time_ns"]
    assert times.tolist() == [*range(NOW_NS, NOW_NS + 50), NOW_NS]


def test_reading_continues_at_the_cursor_in_whole_contributions_and_skips_none(store):
    committed(store, *(contribution(f"b{n}", kind="batch", records=n + 1) for n in range(12)))
    cursor, seen, sizes = 0, [], []
    while (result := store.observations_after(cursor, 10)).entries:
        cursor = result.cursor
        seen += [entry.id for entry in result.entries]
        sizes.append(len(result.rows))
    assert seen == [f"b{n}" for n in range(12)]
    assert sizes == [1 + 2 + 3 + 4, 5, 6, 7, 8, 9, 10, 11, 12]
    assert store.observations_after(cursor, 10).cursor == cursor
    committed(store, contribution("later"))
    assert [entry.id for entry in store.observations_after(cursor, 10).entries] == ["later"]


def commit_one_by_one(store: Store, count: int) -> None:
    for n in range(count):
        store.commit([contribution(f"u{n}")], NOW_NS + n, take_all)


def test_observations_are_forgotten_by_age_once_they_are_fused_and_stay_duplicates(store):
    commit_one_by_one(store, 4)
    assert store.forget(NOW_NS + 10) == 0
    third = store.observations_after(0, 100).entries[2].number
    store.advance(store.progress(), FusionStep(cursor=third))
    assert store.forget(NOW_NS + 2) == 2
    assert store.forget(NOW_NS + 2) == 0
    result = store.observations_after(0, 100)
    assert [result.entries[n].id for n in result.entry_of] == ["u2", "u3"]
    assert store.forget(NOW_NS + 10, most=5) == 1
    assert store.counts() == (4, 4)
    assert committed(store, *(contribution(f"u{n}") for n in range(4))) == ["duplicate"] * 4


def test_forgotten_contributions_are_pruned_by_age_and_their_numbers_not_reused(store):
    commit_one_by_one(store, 4)
    last = store.observations_after(0, 100).entries[3].number
    assert store.prune(NOW_NS + 10) == 0
    store.advance(store.progress(), FusionStep(cursor=last))
    assert store.prune(NOW_NS + 10) == 0
    assert store.forget(NOW_NS + 3) == 3
    assert [store.prune(NOW_NS + 10, most=2) for _ in range(3)] == [2, 1, 0]
    assert store.counts() == (1, 1)
    assert committed(store, contribution("u3")) == ["duplicate"]
    assert store.forget(NOW_NS + 10) == store.prune(NOW_NS + 10) == 1
    assert committed(store, contribution("u4")) == ["stored"]
    assert store.observations_after(0, 100).entries[0].number == last + 1


def test_ledger_rows_received_later_are_not_pruned(store):
    commit_one_by_one(store, 3)
    store.advance(store.progress(), FusionStep(cursor=store.observations_after(0, 100).cursor))
    store.forget(NOW_NS + 10)
    assert store.prune(NOW_NS + 1) == 1
    assert committed(store, *(contribution(f"u{n}") for n in (1, 2))) == ["duplicate"] * 2


def test_at_most_the_given_number_is_forgotten_the_oldest_first(store):
    commit_one_by_one(store, 5)
    store.advance(store.progress(), FusionStep(cursor=store.observations_after(0, 100).cursor))
    assert [store.forget(NOW_NS + 5, most=2) for _ in range(4)] == [2, 2, 1, 0]


def votes(*rows: tuple[int, int, int]) -> np.ndarray:
    result = np.zeros(len(rows), VOTE)
    for name, column in zip(("surface_id", "voter", "session"), np.transpose(rows), strict=True):
        result[name] = column
    return result


def test_a_step_of_the_fusion_is_written_whole(database, store):
    before = store.progress()
    step = FusionStep(cursor=7, surfaces=np.array([4, 2]), votes=votes((4, 1, 1), (2, 9, 3), (4, 5, 1)))
    after = store.advance(before, step)
    assert (before, after) == ((0, 0), (7, 1))
    for reader in (store, database()):
        assert reader.progress() == after
        assert reader.votes_of().tolist() == votes((2, 9, 3), (4, 1, 1), (4, 5, 1)).tolist()
        assert reader.votes_of(np.array([4, 77])).tolist() == votes((4, 1, 1), (4, 5, 1)).tolist()
        assert reader.votes_of(np.array([], np.int64)).tolist() == []


def test_votes_of_a_surface_are_replaced_and_those_of_others_stay(store):
    first = FusionStep(
        cursor=1, surfaces=np.array([1, 2, 3]), votes=votes((1, 1, 1), (2, 1, 1), (2, 2, 1), (3, 1, 1))
    )
    seen = store.advance(store.progress(), first)
    store.advance(seen, FusionStep(cursor=2, surfaces=np.array([2, 3]), votes=votes((2, 3, 1))))
    assert store.votes_of().tolist() == votes((1, 1, 1), (2, 3, 1)).tolist()


def test_a_step_from_outdated_progress_is_not_written(database, store):
    other = database()
    seen = store.progress()
    other.advance(other.progress(), FusionStep(cursor=0))
    with pytest.raises(OvertakenError):
        store.advance(seen, FusionStep(cursor=5, surfaces=np.array([1]), votes=votes((1, 1, 1))))
    assert store.votes_of().tolist() == []
    assert store.advance(store.progress(), FusionStep(cursor=5)).cursor == 5


def test_a_step_with_votes_of_a_surface_it_does_not_list_is_refused_whole(store):
    with pytest.raises(ValueError, match="does not list"):
        store.advance(store.progress(), FusionStep(cursor=5, surfaces=np.array([1]), votes=votes((2, 1, 1))))
    assert store.progress() == (0, 0)


def test_a_fault_in_the_middle_of_a_group_stores_nothing_of_it(store):
    def refusal_of(candidate: Contribution) -> None:
        if candidate.id == "u2":
            raise KeyError("a fault")

    with pytest.raises(KeyError):
        committed(store, contribution("u1"), contribution("u2"), refusal_of=refusal_of)
    assert store.counts() == (0, 0)
    assert committed(store, contribution("u1")) == ["stored"]


GROUPS = st.lists(
    st.lists(
        st.tuples(st.sampled_from("ab"), st.sampled_from("xyz"), st.sampled_from([1.0, 2.0]), st.booleans()),
        max_size=5,
    ),
    max_size=8,
)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(GROUPS)
def test_any_sequence_of_groups_stores_the_first_accepted_content_of_each_id_once(tmp_path_factory, groups):
    path = tmp_path_factory.mktemp("store") / "uploads.sqlite"
    with closing(SqliteStore(path)) as store:
        check_sequence(store, groups)


@needs_postgres
@settings(max_examples=10, deadline=None, derandomize=True)
@given(groups=GROUPS)
def test_any_sequence_of_groups_in_postgres(postgres, groups):
    with closing(PostgresStore(postgres.new_database(), limit_s=10.0)) as store:
        check_sequence(store, groups)


def check_sequence(store: Store, groups) -> None:
    model: dict[tuple[str, str], float] = {}
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
        assert committed(store, *members, refusal_of=refuse_tokyo) == wanted
    assert store.counts() == (len(model), len(model))
