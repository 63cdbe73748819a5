"""Empties an outbox: sends what waits, again and again, until the cloud has acknowledged or refused it.

An upload leaves the outbox only on a receipt for it: `stored` and `duplicate` remove it, `refused` makes it a dead
letter. Everything else (no reply, an error reply, a receipt for another upload, bytes that are none) means: again.

Uploads are tried in a ring, oldest first and round again, so that one that always fails does not hold up the others.
After a failure nothing is sent for a while, which doubles with each further failure from 0.2 s to 10 s, and then one
upload alone feels its way; the first receipt opens the window again. Failures of what was sent before the pause began
are those of the same fault and do not lengthen it.
"""

from __future__ import annotations

import random
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from camber.runtime.uploads.outbox import Outbox, OutboxError, Pending
from camber.schemas.codec import DecodeError, decode
from camber.schemas.fleet import UploadReceipt

SHORTEST_PAUSE_S = 0.2  # chosen: a lost reply is repeated at once
LONGEST_PAUSE_S = 10.0  # chosen: a server is reached within this time of its return
ANSWER_LIMIT_S = 30.0  # the transport has a timeout of its own; this is for one that hangs
_IDLE_S = 1.0  # chosen: longest pause between two looks at the outbox

Reply = tuple[bytes, str]
"""Payload and encoding, as `Bus.ask_bytes` returns them."""
Send = Callable[[str, bytes], "Future[Reply]"]


def pause_s(failures: int, jitter: float) -> float:
    """How long to wait after `failures` ≥ 1 failed rounds; `jitter` in 0…1 spreads a fleet that lost one server."""
    longest = min(LONGEST_PAUSE_S, SHORTEST_PAUSE_S * 2.0 ** min(failures, 16))
    return SHORTEST_PAUSE_S + jitter * (longest - SHORTEST_PAUSE_S)


@dataclass(slots=True, kw_only=True)
class _InFlight:
    upload: Pending
    reply: Future[Reply]
    sent_s: float


class Sender:
    """What to send when: no thread, no clock; `step` gets the time (monotonic, in seconds).

    `counts` has stored, duplicate, refused, failed; `last_failure` says why the last one failed; `waiting` is how many
    were in the outbox a second ago, None while that is not known.
    """

    def __init__(
        self, outbox: Outbox, send: Send, *, window: int = 16, rng: random.Random | None = None
    ) -> None:
        self.counts: Counter[str] = Counter()
        self.last_failure = ""
        self.waiting: int | None = None
        self._counted_s = float("-inf")
        self._outbox = outbox
        self._send = send
        self._window = window
        self._rng = rng or random.Random()
        self._in_flight: dict[int, _InFlight] = {}
        self._position = 0
        self._failures = 0
        self._paused_since_s = self._paused_until_s = float("-inf")
        self._silent_since_s: float | None = None

    def silent_s(self, now_s: float) -> float:
        """For how long nothing that was sent has been acknowledged; 0 while receipts come, or nothing is sent."""
        return 0.0 if self._silent_since_s is None else now_s - self._silent_since_s

    def step(self, now_s: float) -> float:
        """Take in the answers that have come, send what may be sent; returns in how many seconds to look again.

        Call it earlier when an answer comes or something is put into the outbox.
        """
        try:
            self._settle(now_s)
            self._fill(now_s)
            if now_s - self._counted_s >= _IDLE_S:
                self._counted_s = now_s
                self.waiting = self._outbox.counts().pending
        except OutboxError as error:
            self._failed(str(error), now_s, now_s)
        return max(self._paused_until_s - now_s, 0.0) or _IDLE_S

    def _settle(self, now_s: float) -> None:
        over = [f for f in self._in_flight.values() if f.reply.done() or now_s - f.sent_s > ANSWER_LIMIT_S]
        stored = []
        for flight in over:
            del self._in_flight[flight.upload.number]
            receipt = self._receipt(flight, now_s)
            if receipt is None:
                continue
            if receipt.status == "refused":
                self._outbox.refused(flight.upload.id, receipt.reason)
                self._received("refused")
            else:
                stored.append((flight.upload.id, receipt.status))
        if stored:
            self._outbox.acknowledge(upload_id for upload_id, _ in stored)
            for _, status in stored:
                self._received(status)

    def _receipt(self, flight: _InFlight, now_s: float) -> UploadReceipt | None:
        if not flight.reply.done():
            flight.reply.cancel()
            self._failed(f"no answer within {ANSWER_LIMIT_S:.0f} s", flight.sent_s, now_s)
            return None
        try:
            receipt = decode(UploadReceipt, *flight.reply.result()).message
            if receipt.upload_id != flight.upload.id:
                raise DecodeError(f"receipt for {receipt.upload_id} came for {flight.upload.id}")
        except Exception as error:  # whatever the transport raises, it is no receipt
            self._failed(f"{type(error).__name__}: {error}", flight.sent_s, now_s)
            return None
        return receipt

    def _fill(self, now_s: float) -> None:
        if now_s < self._paused_until_s:
            return
        since_pause = sum(f.sent_s >= self._paused_since_s for f in self._in_flight.values())
        room = (1 if self._failures else self._window) - (
            since_pause if self._failures else len(self._in_flight)
        )
        if room <= 0:
            return
        for upload in self._next(room):
            self._position = upload.number
            self._in_flight[upload.number] = _InFlight(
                upload=upload, reply=self._send(upload.channel, upload.payload), sent_s=now_s
            )

    def _next(self, room: int) -> list[Pending]:
        """The next uploads of the ring that are not under way."""
        limit = room + len(self._in_flight)
        ring = self._outbox.pending(limit, after=self._position)
        if len(ring) < limit and self._position > 0:
            known = {upload.number for upload in ring}
            ring += [u for u in self._outbox.pending(limit) if u.number not in known]
        return [upload for upload in ring if upload.number not in self._in_flight][:room]

    def _received(self, status: str) -> None:
        self.counts[status] += 1
        self._failures = 0
        self._silent_since_s = None
        self._paused_until_s = float("-inf")

    def _failed(self, why: str, sent_s: float, now_s: float) -> None:
        self.counts["failed"] += 1
        self.last_failure = why[:512]
        if self._silent_since_s is None:
            self._silent_since_s = sent_s
        if sent_s < self._paused_since_s:
            return
        self._failures += 1
        self._paused_since_s = now_s
        self._paused_until_s = now_s + pause_s(self._failures, self._rng.random())


class SenderThread:
    """Runs a Sender beside the work loop. `ask` blocks until there is a reply and raises if there is none."""

    def __init__(self, outbox: Outbox, ask: Callable[[str, bytes], Reply], *, window: int = 16) -> None:
        self._wake = threading.Event()
        self._stopping = False
        self._ask = ask
        self._pool = ThreadPoolExecutor(window, thread_name_prefix="upload")
        self.sender = Sender(outbox, self._submit, window=window)
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Something has been put into the outbox; without this it is found within a second."""
        self._wake.set()

    def close(self, timeout_s: float = 1.0) -> None:
        """Send no more; what has no receipt yet stays in the outbox. Close this before the outbox and the bus."""
        self._stopping = True
        self._wake.set()
        self._thread.join(timeout_s)
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _submit(self, channel: str, payload: bytes) -> Future[Reply]:
        future = self._pool.submit(self._ask, channel, payload)
        future.add_done_callback(lambda _: self._wake.set())
        return future

    def _run(self) -> None:
        while not self._stopping:
            self._wake.clear()
            try:
                delay_s = self.sender.step(time.monotonic())
            except Exception as error:  # the thread must outlive whatever it meets: nobody would restart it
                self.sender.last_failure = f"{type(error).__name__}: {error}"[:512]
                delay_s = _IDLE_S
            self._wake.wait(delay_s)
