"""Uploads are handed over at once, made durable beside the work loop, and problems come back to it."""

import threading
import time
from contextlib import ExitStack, closing
from unittest.mock import Mock

import pytest

from camber.runtime.uploads import uploader as module
from camber.runtime.uploads.outbox import Outbox, OutboxError, OutboxFull
from camber.runtime.uploads.uploader import Uploader
from camber.schemas.codec import decode, encode, encoding_of
from camber.schemas.fleet import ReleaseHead, UploadReceipt
from support.streams import wait_for

T = 1_300_000_000 * 10**9
LIMIT = 4 << 20


def message(version=1):
    return ReleaseHead(time_ns=T, region="here", map_version=version, manifest_sha256="0" * 64)


def silent(channel, data):
    raise RuntimeError("nobody answers")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "outbox.sqlite"


@pytest.fixture
def make(path):
    """Makes uploaders, and closes them at the end of the test at the latest."""
    with ExitStack() as made:
        yield lambda ask=silent: made.enter_context(
            closing(Uploader(path, vehicle="car", source="integrity", limit_bytes=LIMIT, ask=ask))
        )


@pytest.fixture
def gate(monkeypatch):
    """Holds up what an uploader stores until it is opened; then `check` may still refuse it."""

    def gated(uploader, check=lambda uploads: None):
        put_many, entered, opened = uploader.outbox.put_many, threading.Event(), threading.Event()

        def put(uploads):
            entered.set()
            opened.wait(5.0)
            check(uploads)
            put_many(uploads)

        monkeypatch.setattr(uploader.outbox, "put_many", put)
        return entered, opened

    return gated


def put(uploader, *numbers):
    for number in numbers:
        uploader.put(f"u{number}", "upload", message(number))


def waiting(path):
    with closing(Outbox(path, vehicle="car", limit_bytes=LIMIT)) as outbox:
        return outbox.pending(1000)


class Server:
    """Says the same of every upload."""

    def __init__(self, status="stored"):
        self.status = status
        self.asked = []

    def __call__(self, channel, data):
        version = decode(ReleaseHead, data, None).message.map_version
        self.asked.append((channel, version))
        receipt = UploadReceipt(time_ns=T, vehicle="v", upload_id=f"u{version}", status=self.status)
        return encode(receipt), encoding_of(UploadReceipt)


def test_what_was_handed_over_is_on_the_disk_after_close(path, make):
    uploader = make()
    put(uploader, *range(50))
    uploader.close()
    result = waiting(path)
    assert [pending.id for pending in result] == [f"u{k}" for k in range(50)]
    assert decode(ReleaseHead, result[7].payload, None).message == message(7)


def test_it_is_sent_and_leaves_when_it_is_acknowledged(make):
    server = Server()
    uploader = make(server)
    uploader.put("u1", "upload_batch", message(1))
    wait_for(lambda: server.asked and uploader.outbox.counts().pending == 0)
    uploader.close()
    assert server.asked == [("upload_batch", 1)]
    assert uploader.problems() == []


def test_that_nobody_answers_is_a_problem_reported_when_it_grows(make):
    uploader = make()
    put(uploader, 1)
    wait_for(lambda: uploader.sender.sender.last_failure)
    uploader.sender.close()
    assert uploader.problems() == [("upload_unanswered", "RuntimeError: nobody answers")]
    assert uploader.problems() == []


def test_that_no_receipt_comes_for_long_is_reported_with_what_to_look_at(make, monkeypatch):
    monkeypatch.setattr(module, "_SILENT_S", 0.3)
    server, answers = Server(), threading.Event()

    def denied(channel, data):
        return server(channel, data) if answers.is_set() else silent(channel, data)

    uploader = make(denied)
    put(uploader, 1)
    wait_for(lambda: uploader.sender.sender.counts["failed"])
    assert "upload_not_acknowledged" not in dict(uploader.problems())
    time.sleep(0.4)
    text = dict(uploader.problems())["upload_not_acknowledged"]
    assert text.startswith("no receipt for ")
    assert "certificate" in text
    assert "nobody answers" in text
    assert "upload_not_acknowledged" not in dict(uploader.problems()), "not in every round"
    answers.set()
    wait_for(lambda: uploader.sender.sender.counts["stored"])
    time.sleep(0.4)
    assert "upload_not_acknowledged" not in dict(uploader.problems())


def test_a_refusal_is_a_problem(make):
    uploader = make(Server("refused"))
    put(uploader, 1)
    wait_for(lambda: uploader.sender.sender.counts["refused"] > 0)
    assert ("upload_refused", "1 are dead letters") in uploader.problems()


def test_a_damaged_outbox_is_a_problem(path, make):
    path.write_bytes(b"no database at all" * 1000)
    assert [code for code, _ in make().problems()] == ["outbox_damaged"]


def test_a_disk_that_fails_for_a_while_loses_nothing(path, make, monkeypatch):
    monkeypatch.setattr(module, "_RETRY_S", 0.01)
    uploader = make()
    put_many, failing = uploader.outbox.put_many, threading.Event()
    failing.set()

    def hindered(uploads):
        if failing.is_set():
            raise OutboxError("no room left")
        put_many(uploads)

    monkeypatch.setattr(uploader.outbox, "put_many", hindered)
    put(uploader, 1)
    wait_for(lambda: ("upload_not_stored", "no room left") in uploader.problems())
    put(uploader, 2)
    failing.clear()
    wait_for(lambda: uploader.outbox.counts().pending == 2)
    uploader.close()
    assert [pending.id for pending in waiting(path)] == ["u1", "u2"]


def test_one_that_still_fails_at_the_end_is_reported(make, monkeypatch):
    uploader = make()
    monkeypatch.setattr(uploader.outbox, "put_many", Mock(side_effect=OutboxError("no room left")))
    put(uploader, 1)
    uploader.close()
    assert ("upload_lost", "1 uploads: no room left") in uploader.problems()


def test_an_id_that_is_taken_costs_only_that_upload(path, make, gate):
    uploader = make()
    entered, opened = gate(uploader)
    put(uploader, 1)
    assert entered.wait(5.0)
    put(uploader, 2)  # one group: the writer waits for the first
    uploader.put("u1", "upload", message(99))
    put(uploader, 3)
    opened.set()
    uploader.close()
    assert [pending.id for pending in waiting(path)] == ["u1", "u2", "u3"]
    (text,) = [text for code, text in uploader.problems() if code == "upload_lost"]
    assert "u1" in text


def test_more_than_the_queue_holds_is_dropped_and_reported_and_close_still_ends(make, gate, monkeypatch):
    monkeypatch.setattr(module, "_QUEUE_LIMIT", 2)
    monkeypatch.setattr(module, "_STORE_LIMIT_S", 0.05)
    uploader = make()
    entered, opened = gate(uploader)
    put(uploader, 0)
    assert entered.wait(5.0)
    put(uploader, 1, 2, 3, 4)
    uploader.close()
    codes = [code for code, _ in uploader.problems()]
    assert codes.count("upload_dropped") == 2
    assert "upload_lost" in codes
    opened.set()
    uploader._writer.join(5.0)
    assert not uploader._writer.is_alive()


def test_how_many_uploads_wait_is_known_without_asking_the_disk(make):
    uploader = make()
    put(uploader, *range(7))
    wait_for(lambda: uploader.waiting() == {"uploads_not_stored": 0.0, "uploads_waiting": 7.0})


def test_of_a_group_for_which_there_is_no_room_so_much_is_kept_as_fits(path, make, gate):
    uploader = make()

    def room_for_seven(uploads):
        if len(uploads) + uploader.outbox.counts().pending > 7:
            raise OutboxFull("no room left")

    entered, opened = gate(uploader, room_for_seven)
    put(uploader, 0)
    assert entered.wait(5.0)
    put(uploader, *range(1, 20))  # one group: the writer waits for the first
    opened.set()
    uploader.close()
    assert [pending.id for pending in waiting(path)] == [f"u{n}" for n in range(7)]
    lost = [text for code, text in uploader.problems() if code == "upload_lost"]
    assert lost == ["13 uploads: no room left"]
