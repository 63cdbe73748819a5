"""The sender tries until there is a receipt, never faster than it should, and loses nothing to a bad cloud."""

import os
import random
import shutil
import tempfile
import threading
from concurrent.futures import Future
from contextlib import closing
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from camber.runtime.uploads.outbox import Outbox, OutboxError, Upload
from camber.runtime.uploads.sender import (
    ANSWER_LIMIT_S,
    LONGEST_PAUSE_S,
    SHORTEST_PAUSE_S,
    Sender,
    SenderThread,
    pause_s,
)
from camber.schemas.codec import encode, encoding_of
from camber.schemas.fleet import UploadReceipt

TIME_NS = 1_300_000_000 * 1_000_000_000
LIMIT = 4 << 20


def receipt(upload_id: str, status: str = "stored", reason: str = "") -> tuple[bytes, str]:
    message = UploadReceipt(time_ns=TIME_NS, vehicle="v", upload_id=upload_id, status=status, reason=reason)
    return encode(message), encoding_of(UploadReceipt)


class Wire:
    """Everything that was sent and waits for its answer; the payload is the upload's id."""

    def __init__(self):
        self.open: dict[str, Future] = {}
        self.log: list[str] = []

    def send(self, channel: str, payload: bytes) -> Future:
        assert channel == "upload"
        future: Future = Future()
        self.open[payload.decode()] = future
        self.log.append(payload.decode())
        return future

    def answer(self, upload_id: str, status: str = "stored", reason: str = "") -> None:
        self.open.pop(upload_id).set_result(receipt(upload_id, status, reason))

    def fail(self, upload_id: str) -> None:
        self.open.pop(upload_id).set_exception(RuntimeError("timeout"))


@pytest.fixture
def outbox(tmp_path):
    with closing(Outbox(tmp_path / "outbox.sqlite", vehicle="car", limit_bytes=LIMIT)) as outbox:
        yield outbox


@pytest.fixture
def wire():
    return Wire()


def put(outbox, *ids):
    outbox.put_many([Upload(upload_id, "upload", upload_id.encode()) for upload_id in ids])


def sending(outbox, wire, *ids, **more):
    """A sender of these uploads after its first step."""
    put(outbox, *ids)
    sender = Sender(outbox, wire.send, **more)
    sender.step(0.0)
    return sender


def waiting(outbox):
    return [pending.id for pending in outbox.pending(1000)]


@pytest.mark.parametrize("status", ["stored", "duplicate", "refused"])
def test_an_upload_leaves_when_the_cloud_has_it_or_refuses_it(outbox, wire, status):
    sender = sending(outbox, wire, "a", "b")
    assert waiting(outbox) == ["a", "b"]
    wire.answer("a", status, "datum" if status == "refused" else "")
    sender.step(0.1)
    assert waiting(outbox) == ["b"]
    assert outbox.dead_letters() == ([("a", "datum")] if status == "refused" else [])
    assert sender.counts == {status: 1}


@pytest.mark.parametrize(
    "answer",
    [
        (b"", ""),
        (b"stored", "text/plain"),
        receipt("another"),
        (receipt("a")[0], "application/msgpack;camber.Fix.v1"),
        (receipt("a")[0][:-1], receipt("a")[1]),
        None,
    ],
    ids=["empty", "text", "of another upload", "of another kind", "cut off", "nothing"],
)
def test_what_is_no_receipt_leaves_the_upload_waiting_and_it_is_sent_again(outbox, wire, answer):
    sender = sending(outbox, wire, "a")
    wire.open.pop("a").set_result(answer)
    sender.step(0.1)
    assert waiting(outbox) == ["a"]
    assert sender.counts == {"failed": 1}
    sender.step(1.0)
    assert wire.log == ["a", "a"]


def test_a_transport_that_never_answers_is_given_up_and_its_late_receipt_ignored(outbox, wire):
    sender = sending(outbox, wire, "a")
    late = wire.open["a"]
    assert sender.step(ANSWER_LIMIT_S) > 0.0
    assert sender.counts == {}
    sender.step(ANSWER_LIMIT_S + 0.1)
    sender.step(ANSWER_LIMIT_S + 1.0)
    assert wire.log == ["a", "a"]
    assert late.cancelled()


def test_no_more_are_in_flight_than_the_window_and_none_twice(outbox, wire):
    put(outbox, *(f"u{n}" for n in range(10)))
    sender = Sender(outbox, wire.send, window=4)
    for now_s in range(5):
        sender.step(float(now_s))
    assert wire.log == ["u0", "u1", "u2", "u3"]
    wire.answer("u2")
    sender.step(5.0)
    assert wire.log == ["u0", "u1", "u2", "u3", "u4"]


def test_what_is_put_while_others_are_in_flight_is_sent_once(outbox, wire):
    sender = sending(outbox, wire, "a", "b", "c", window=10)
    put(outbox, "d", "e")
    sender.step(1.0)
    assert wire.log == ["a", "b", "c", "d", "e"]


class LongestJitter(random.Random):
    def random(self):
        return 1.0


def test_after_a_failure_one_upload_probes_and_the_first_receipt_opens_the_window(outbox, wire):
    sender = sending(outbox, wire, *(f"u{n}" for n in range(10)), window=4, rng=LongestJitter())
    for n in range(4):
        wire.fail(f"u{n}")
    pause = sender.step(1.0)
    assert pause == pytest.approx(pause_s(1, 1.0))  # four failures of one fault are one
    sender.step(1.0 + pause / 2)
    assert len(wire.log) == 4
    sender.step(1.001 + pause)
    assert wire.log[4:] == ["u4"]
    wire.answer("u4")
    sender.step(2.0)
    assert wire.log[5:] == ["u5", "u6", "u7", "u8"]


def test_pauses_double_up_to_their_longest_and_begin_anew_after_a_receipt(outbox, wire):
    put(outbox, "a", "b")
    sender = Sender(outbox, wire.send, window=1, rng=random.Random(1))
    now_s, pauses = 0.0, []
    for _ in range(40):
        sender.step(now_s)
        wire.fail(wire.log[-1])
        pause = sender.step(now_s)
        pauses.append(pause)
        now_s += pause
    assert max(pauses[:1]) <= 2 * SHORTEST_PAUSE_S
    assert max(pauses) <= LONGEST_PAUSE_S
    assert max(pauses[6:]) > LONGEST_PAUSE_S / 2
    sender.step(now_s)
    wire.answer(wire.log[-1])
    sender.step(now_s)
    wire.fail(wire.log[-1])
    assert sender.step(now_s) <= 2 * SHORTEST_PAUSE_S


@pytest.mark.parametrize("failures", [1, 2, 3, 10, 1000, 10**9])
def test_a_pause_is_spread_between_the_shortest_and_its_doubled_bound(failures):
    assert pause_s(failures, 0.0) == SHORTEST_PAUSE_S
    assert pause_s(failures, 1.0) == min(LONGEST_PAUSE_S, SHORTEST_PAUSE_S * 2.0 ** min(failures, 60))


def test_an_upload_that_always_fails_does_not_hold_up_the_others(outbox, wire):
    put(outbox, *(f"u{n}" for n in range(50)))
    sender = Sender(outbox, wire.send, window=1)
    now_s = 0.0
    while len(waiting(outbox)) > 1:
        assert now_s < 300.0
        now_s += sender.step(now_s)
        for upload_id in list(wire.open):
            if upload_id == "u0":
                wire.fail(upload_id)
            else:
                wire.answer(upload_id)
    assert waiting(outbox) == ["u0"]
    assert wire.log.count("u0") > 1


def test_an_outbox_that_cannot_note_a_receipt_sends_again(outbox, wire, monkeypatch):
    sender = sending(outbox, wire, "a")
    wire.answer("a")
    with monkeypatch.context() as patched:
        patched.setattr(outbox, "acknowledge", failing)
        sender.step(0.1)
    assert "no room" in sender.last_failure
    sender.step(1.0)
    assert wire.log == ["a", "a"]
    wire.answer("a", "duplicate")
    sender.step(1.1)
    assert waiting(outbox) == []


def failing(*_):
    raise OutboxError("no room")


class BadCloud(RuleBasedStateMachine):
    """Replies are lost, garbled, late or refused, the sender is killed and started again: nothing is lost."""

    def __init__(self):
        super().__init__()
        memory = Path("/dev/shm")  # thousands of flushes; what survives them is the business of test_outbox
        self.folder = Path(tempfile.mkdtemp(dir=memory if os.access(memory, os.W_OK) else None))
        self.stored: dict[str, int] = {}
        self.promised: list[str] = []
        self.now_s = 0.0
        self.start()

    def start(self):
        self.outbox = Outbox(self.folder / "outbox.sqlite", vehicle="car", limit_bytes=LIMIT)
        self.wire = Wire()
        self.sender = Sender(self.outbox, self.wire.send, window=3, rng=random.Random(0))

    def teardown(self):
        for _ in range(20 + 20 * len(self.promised)):
            if not waiting(self.outbox):
                break
            self.step(100.0)
            for upload_id in sorted(self.wire.open):
                self.reply(upload_id)
        assert waiting(self.outbox) == []
        assert set(self.stored) == {u for u in self.promised if not self.is_bad(u)}
        assert set(self.stored.values()) <= {1}
        self.outbox.close()
        shutil.rmtree(self.folder)

    @staticmethod
    def is_bad(upload_id):
        return int(upload_id[1:]) % 7 == 3

    def reply(self, upload_id):
        """What an honest cloud does: store, then say so."""
        if self.is_bad(upload_id):
            self.wire.answer(upload_id, "refused", "bad")
        elif upload_id in self.stored:
            self.wire.answer(upload_id, "duplicate")
        else:
            self.stored[upload_id] = self.stored.get(upload_id, 0) + 1
            self.wire.answer(upload_id)

    @rule(n=st.integers(1, 4))
    def put(self, n):
        for _ in range(n):
            upload_id = f"u{len(self.promised)}"
            put(self.outbox, upload_id)
            self.promised.append(upload_id)

    @rule(seconds=st.sampled_from([0.0, 0.1, 1.0, 15.0, 60.0]))
    def step(self, seconds):
        self.now_s += seconds
        self.sender.step(self.now_s)
        self.wire.open = {u: f for u, f in self.wire.open.items() if not f.cancelled()}

    @precondition(lambda self: self.wire.open)
    @rule(
        data=st.data(),
        how=st.sampled_from(["honest", "honest", "stored, reply lost", "lost", "garbled", "crossed"]),
    )
    def answer(self, data, how):
        upload_id = data.draw(st.sampled_from(sorted(self.wire.open)))
        if how == "honest":
            self.reply(upload_id)
        elif how == "stored, reply lost":
            self.reply(upload_id) if self.is_bad(upload_id) else self.stored.setdefault(upload_id, 1)
        elif how == "lost":
            self.wire.fail(upload_id)
        elif how == "garbled":
            self.wire.open.pop(upload_id).set_result((receipt(upload_id)[0][::-1], receipt(upload_id)[1]))
        else:
            self.wire.open.pop(upload_id).set_result(receipt("u99999"))

    @rule()
    def kill_and_start(self):
        self.outbox.close()
        self.start()

    @invariant()
    def everything_promised_is_somewhere(self):
        dead = {upload_id for upload_id, _ in self.outbox.dead_letters()}
        assert set(self.promised) <= set(waiting(self.outbox)) | set(self.stored) | dead
        assert all(self.is_bad(upload_id) for upload_id in dead)


TestBadCloud = BadCloud.TestCase
TestBadCloud.settings = settings(
    max_examples=40,
    stateful_step_count=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)


def test_the_thread_empties_the_outbox_through_a_bad_transport(outbox):
    stored: set[str] = set()
    lock = threading.Lock()
    rng = random.Random(5)

    def ask(channel: str, payload: bytes) -> tuple[bytes, str]:
        upload_id = payload.decode()
        with lock:
            luck = rng.random()
            status = "duplicate" if upload_id in stored else "stored"
            if luck < 0.01:
                raise RuntimeError("timeout")
            stored.add(upload_id)
            if luck < 0.02:
                return b"", ""
        return receipt(upload_id, status)

    ids = [f"u{n}" for n in range(300)]
    sending = SenderThread(outbox, ask, window=8)
    put(outbox, *ids)
    sending.wake()
    gone = threading.Event()
    for _ in range(600):
        if outbox.counts().pending == 0:
            break
        gone.wait(0.05)
    sending.close()
    assert outbox.counts() == (0, 0)
    assert stored == set(ids)
    assert sending.sender.counts["stored"] + sending.sender.counts["duplicate"] == 300


def test_a_fault_in_the_thread_is_reported_and_does_not_end_it(outbox, monkeypatch):
    seen = threading.Event()
    calls = []

    def pending(limit, *, after=0):
        calls.append(limit)
        if len(calls) > 1:
            seen.set()
        raise KeyError("a fault")

    monkeypatch.setattr(outbox, "pending", pending)
    sending = SenderThread(outbox, lambda channel, payload: receipt("a"))
    assert seen.wait(20.0)
    sending.close()
    assert "a fault" in sending.sender.last_failure
