"""The outbox keeps what it has taken: through kills, full disks and damage."""

import os
import random
import re
import resource
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing, contextmanager

import pytest

from camber.runtime.uploads.outbox import DAMAGED_ON_DISK, Outbox, OutboxError, OutboxFull, Upload
from camber.runtime.uploads.sqlite_recovery import replace_damaged

LIMIT = 8 << 20


def upload(number: int, size: int = 200) -> Upload:
    return Upload(f"u{number}", "upload", random.Random(number).randbytes(size))


def opened(path, limit_bytes=LIMIT):
    return closing(Outbox(path, vehicle="car", limit_bytes=limit_bytes))


def held(outbox: Outbox) -> list[Upload]:
    return [Upload(*pending[1:]) for pending in outbox.pending(1_000_000)]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "outbox.sqlite"


def stored(path, uploads) -> bytearray:
    """The bytes of an outbox with these uploads."""
    with opened(path) as outbox:
        outbox.put_many(uploads)
    return bytearray(path.read_bytes())


@contextmanager
def no_file_larger_than(size_bytes):
    """What a full disk does to a write, without needing one."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_uploads_wait_in_the_order_in_which_they_were_put(path):
    with opened(path) as outbox:
        outbox.put_many([upload(3)])
        outbox.put_many([upload(1), upload(2)])
        assert held(outbox) == [upload(3), upload(1), upload(2)]
        assert [p.id for p in outbox.pending(2)] == ["u3", "u1"]
        assert [p.id for p in outbox.pending(2, after=outbox.pending(1)[0].number)] == ["u1", "u2"]


def test_what_was_put_is_there_when_the_outbox_is_opened_again(path):
    stored(path, [upload(n) for n in range(10)])
    with opened(path) as outbox:
        outbox.acknowledge(["u0", "u9"])
    with opened(path) as outbox:
        assert held(outbox) == [upload(n) for n in range(1, 9)]
        assert outbox.notice is None


def test_an_upload_put_twice_waits_once_and_another_one_under_its_id_is_an_error(path):
    with opened(path) as outbox:
        outbox.put_many([upload(1)])
        outbox.put_many([upload(1)])
        assert held(outbox) == [upload(1)]
        with pytest.raises(ValueError, match="u1"):
            outbox.put_many([upload(2), Upload("u1", "upload", b"other")])
        assert held(outbox) == [upload(1)], "nothing of its group is stored"


def test_numbers_are_not_used_again(path):
    with opened(path) as outbox:
        outbox.put_many([upload(1)])
        first = outbox.pending(1)[0].number
        outbox.acknowledge(["u1"])
        outbox.put_many([upload(2)])
        assert outbox.pending(1)[0].number > first


def test_a_refused_upload_becomes_a_dead_letter_and_what_is_not_there_changes_nothing(path):
    with opened(path) as outbox:
        outbox.put_many([upload(1), upload(2)])
        outbox.acknowledge(["u5", "u3"])
        outbox.refused("u4", "unknown")
        assert outbox.counts() == (2, 0)
        outbox.refused("u1", "datum unknown")
        assert held(outbox) == [upload(2)]
        assert outbox.dead_letters() == [("u1", "datum unknown")]


def test_of_the_dead_letters_the_newest_are_kept(path):
    limit_bytes = 64 * 4096  # dead letters: 32 kB
    with opened(path, limit_bytes) as outbox:
        for number in range(60):
            outbox.put_many([upload(number, 2000)])
            outbox.refused(f"u{number}", "no")
        letters = [letter for letter, _ in outbox.dead_letters()]
        assert letters == [f"u{n}" for n in range(60 - limit_bytes // 8 // 2000, 60)]


def test_a_limit_too_small_for_its_tables_is_an_error(path):
    with pytest.raises(ValueError, match="limit_bytes"):
        Outbox(path, vehicle="car", limit_bytes=4096)


def test_a_full_outbox_says_so_names_its_file_and_keeps_what_it_has(path):
    limit_bytes = 64 * 4096
    with opened(path, limit_bytes) as outbox:
        taken = fill(outbox, range(1000))
        assert taken
        with pytest.raises(OutboxFull, match="no room"):
            outbox.put_many([upload(1001, 1000)])
        assert held(outbox) == taken
        outbox.acknowledge([u.id for u in taken[:10]])
        outbox.put_many([upload(2000, 1000)])
        assert held(outbox) == [*taken[10:], upload(2000, 1000)]
    assert path.stat().st_size <= limit_bytes


def test_a_full_outbox_can_still_file_away_every_refusal(path):
    with opened(path, 64 * 4096) as outbox:
        taken = fill(outbox, range(1000))
        for u in taken:
            outbox.refused(u.id, "r" * 512)
        assert outbox.counts().pending == 0
        assert outbox.dead_letters()[-1] == (taken[-1].id, "r" * 512)


def fill(outbox: Outbox, numbers) -> list[Upload]:
    """Put until the outbox takes no more; returns what it has taken."""
    taken = []

    def put_all():
        for number in numbers:
            outbox.put_many([upload(number, 1000)])
            taken.append(upload(number, 1000))

    with pytest.raises(OutboxError, match=re.escape(str(outbox.path))):
        put_all()
    return taken


def test_a_disk_that_takes_no_more_loses_nothing_and_the_outbox_goes_on_when_there_is_room(path):
    first = [upload(n) for n in range(100)]
    with opened(path) as outbox:
        outbox.put_many(first)
        with no_file_larger_than(128 << 10):
            taken = fill(outbox, range(100, 2000))
            assert taken
            assert held(outbox) == [*first, *taken]
        outbox.put_many([upload(2000)])
        assert held(outbox) == [*first, *taken, upload(2000)]
    with opened(path) as outbox:
        assert held(outbox) == [*first, *taken, upload(2000)]


def test_an_outbox_that_cannot_be_opened_says_so_on_put_and_works_when_it_can(tmp_path):
    folder = tmp_path / "state"
    folder.write_text("a file where a folder should be")
    outbox = Outbox(folder / "outbox.sqlite", vehicle="car", limit_bytes=LIMIT)
    with pytest.raises(OutboxError, match=r"outbox\.sqlite"):
        outbox.put_many([upload(1)])
    folder.unlink()
    with closing(outbox):
        outbox.put_many([upload(1)])
        assert held(outbox) == [upload(1)]


def test_a_locked_file_is_an_error_and_no_damage(path, monkeypatch):
    monkeypatch.setattr("camber.runtime.uploads.outbox._WAIT_S", 0.01)
    with opened(path) as outbox, closing(sqlite3.connect(path, isolation_level=None)) as other:
        outbox.put_many([upload(1)])
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(OutboxError, match="locked"):
            outbox.put_many([upload(2)])
        other.execute("ROLLBACK")
        outbox.put_many([upload(2)])
        assert held(outbox) == [upload(1), upload(2)]
        assert outbox.notice is None


WRITER = """
import os, random, sys
from pathlib import Path
from camber.runtime.uploads.outbox import Outbox, Upload
path, first, seed = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
rng, outbox, number = random.Random(seed), Outbox(path, vehicle="car", limit_bytes=64 << 20), first
while True:
    numbers = range(number, number + rng.choice((1, 1, 5, 50)))
    outbox.put_many([Upload(f"u{n}", "upload", random.Random(n).randbytes(200)) for n in numbers])
    os.write(1, "".join(f"put {n}\\n" for n in numbers).encode())
    number = numbers[-1] + 1
    if rng.random() < 0.5:
        gone = [p.id for p in outbox.pending(20)]
        os.write(1, "".join(f"remove {i[1:]}\\n" for i in gone).encode())
        outbox.acknowledge(gone)
"""


def test_a_writer_killed_at_any_moment_has_lost_nothing_that_was_put(path):
    rng = random.Random(20)
    promised: set[int] = set()
    removed: set[int] = set()
    for kill in range(12):
        first = kill * 1_000_000
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path), str(first), str(kill)],
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            text=True,
        )
        lines = [writer.stdout.readline() for _ in range(rng.randrange(1, 400))]
        writer.send_signal(signal.SIGKILL)
        lines += writer.stdout.read().splitlines()  # what it could still say before the end
        writer.stdout.close()
        assert writer.wait() == -signal.SIGKILL
        for action, number in (line.split() for line in lines if line.strip()):
            (promised if action == "put" else removed).add(int(number))
        with opened(path, 64 << 20) as outbox:
            assert outbox.notice is None
            numbers = [int(u.id[1:]) for u in held(outbox)]
            assert held(outbox) == [upload(n) for n in numbers]
            assert len(numbers) == len(set(numbers))
            assert promised - removed <= set(numbers)
    assert len(promised) > 300


@pytest.mark.parametrize("seed", range(60))
def test_damage_is_noticed_the_file_renamed_and_never_changes_an_upload(path, seed):
    rng = random.Random(seed)
    put = [upload(n, rng.choice((50, 300, 9000))) for n in range(200)]
    data = stored(path, put)
    for _ in range(rng.choice((1, 1, 3, 30))):
        place = rng.randrange(100) if rng.random() < 0.2 else rng.randrange(len(data))
        data[place] ^= 1 << rng.randrange(8)
    path.write_bytes(data)
    with opened(path) as outbox:
        result = held(outbox)
        dead = {letter for letter, reason in outbox.dead_letters() if reason == DAMAGED_ON_DISK}
        assert set(result) <= set(put)
        missing = {u.id for u in put} - {u.id for u in result}
        if missing - dead:
            assert "outbox.sqlite.corrupt" in outbox.notice
            assert path.with_name("outbox.sqlite.corrupt").read_bytes()[4096:] == data[4096:]
        outbox.put_many([upload(n) for n in range(1000, 1100)])
        assert len(held(outbox)) == len(result) + 100


def test_one_damaged_page_costs_only_the_uploads_on_it(path):
    data = stored(path, [upload(n) for n in range(1000)])
    page = data.index(upload(500).payload) // 4096
    data[page * 4096 : page * 4096 + 64] = bytes(64)
    path.write_bytes(data)
    with opened(path) as outbox:
        assert len(held(outbox)) >= 1000 - 4096 // 200
        assert outbox.notice is not None


@pytest.mark.parametrize("place", range(100))
def test_a_flipped_bit_in_the_head_of_the_file_does_not_stop_the_outbox(path, place):
    put = [upload(n) for n in range(5)]
    data = stored(path, put)
    data[place] ^= 1 << (place % 8)
    path.write_bytes(data)
    with opened(path) as outbox:
        assert outbox.notice is not None or held(outbox) == put
        outbox.put_many([upload(10)])
        assert held(outbox)[-1] == upload(10)


@pytest.mark.parametrize(
    ("damage", "kept"),
    [
        (lambda data: data.replace(b"upload", b"uploaX"), []),
        (lambda data: data.replace(b"dead_letter", b"dead_letteX"), [upload(1)]),
        (lambda data: b"not a database" * 1000, []),
    ],
    ids=["a table has lost its name", "another has lost its name", "no database"],
)
def test_a_file_that_is_no_outbox_is_renamed_and_no_empty_outbox(path, damage, kept):
    path.write_bytes(damage(stored(path, [upload(1)])))
    with opened(path) as outbox:
        outbox.put_many([upload(2)])
        assert "outbox.sqlite.corrupt" in outbox.notice
        assert held(outbox) == [*kept, upload(2)]


def test_damage_while_it_runs_is_repaired_and_the_put_succeeds(path):
    with opened(path) as outbox:
        outbox.put_many([upload(n) for n in range(500)])
        assert outbox.counts().pending == 500
        with closing(sqlite3.connect(path)) as other:
            other.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        data = bytearray(path.read_bytes())
        for page in range(2, len(data) // 4096, 7):
            data[page * 4096] = 0xFF
        path.write_bytes(data)
        with closing(sqlite3.connect(path, isolation_level=None)) as other:
            other.execute("PRAGMA user_version = 1")  # makes the outbox drop its cache
        for number in range(500, 900):
            outbox.put_many([upload(number)])
        assert outbox.notice is not None
        assert [u.id for u in held(outbox)][-400:] == [f"u{n}" for n in range(500, 900)]


def test_a_swap_cut_off_in_between_is_finished_on_the_next_start(tmp_path, path):
    fresh = tmp_path / "outbox.sqlite.fresh"
    stored(fresh, [upload(1)])
    path.write_bytes(b"damaged")
    (tmp_path / "outbox.sqlite-wal").write_bytes(b"damaged log")
    with opened(path) as outbox:
        assert held(outbox) == [upload(1)]
    assert (tmp_path / "outbox.sqlite.corrupt").read_bytes() == b"damaged"
    assert (tmp_path / "outbox.sqlite.corrupt-wal").read_bytes() == b"damaged log"
    assert not fresh.exists()


def test_where_there_is_no_room_to_mend_a_damaged_file_it_stays_as_it_is(tmp_path, path):
    """On a full disk SQLite leaves what it has written in its log, and does not say so."""
    path.write_bytes(b"damaged")
    (tmp_path / "outbox.sqlite.corrupt").write_bytes(b"the last copy")

    def on_a_full_disk(making):
        making.write_bytes(b"little")
        making.with_name(making.name + "-wal").write_bytes(b"much")

    with pytest.raises(OSError, match="No space left"):
        replace_damaged(path, on_a_full_disk)
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {
        "outbox.sqlite": b"damaged",
        "outbox.sqlite.corrupt": b"the last copy",
    }


def test_any_changed_byte_or_cut_is_named_or_changes_no_upload(path):
    put = [upload(n) for n in range(20)]
    data = stored(path, put)
    print("seed 24")
    rng = random.Random(24)
    for k in range(200):
        damaged = bytearray(data)
        at = rng.randrange(len(data))
        damaged[at] ^= rng.randrange(1, 256)
        path.write_bytes(damaged if k % 10 else data[:at])
        for log in ("-wal", "-shm"):
            path.with_name(path.name + log).unlink(missing_ok=True)
        with opened(path) as outbox:
            result = held(outbox)
            dead = {letter for letter, _ in outbox.dead_letters()}
            assert set(result) <= set(put)
            if {u.id for u in put} - {u.id for u in result} - dead:
                assert "outbox.sqlite.corrupt" in outbox.notice


def test_an_outbox_of_another_vehicle_is_rejected_and_none_of_it_is_sent(path):
    data = stored(path, [upload(1)])
    with closing(Outbox(path, vehicle="car-2", limit_bytes=LIMIT)) as outbox:
        assert held(outbox) == []
        assert outbox.notice == (
            f"{path} is of another vehicle: moved to outbox.sqlite.corrupt, 0 uploads carried over"
        )
    assert path.with_name("outbox.sqlite.corrupt").read_bytes()[8192:] == data[8192:]


def test_uploads_of_an_outbox_of_before_it_named_its_vehicle_are_carried_over(path):
    stored(path, [upload(1), upload(2)])
    with sqlite3.connect(path) as db:
        db.execute("DROP TABLE identity")
    with opened(path) as outbox:
        assert held(outbox) == [upload(1), upload(2)]
        assert "earlier format" in outbox.notice


def test_a_pipe_in_the_place_of_an_outbox_is_rejected_and_does_not_block(path):
    os.mkfifo(path)
    with opened(path) as outbox:
        assert "outbox.sqlite.corrupt" in outbox.notice
        outbox.put_many([upload(1)])
        assert held(outbox) == [upload(1)]
