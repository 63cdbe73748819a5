"""The judge on a canyon: its CPU an epoch, from bytes to bytes, and how long after the fix its verdict is there.

CPU: one process, the drive's own messages as `integrity` receives them, without other estimates; beside it what it
takes only to decode and encode the same messages. Latency: all processes of a replay at 10 Hz with the positions of the
engine, of which many ask for 20 other estimates; the peer is the goal, as there is no other judge to measure beside it.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from figure import Figure, camber, least_s, lower, percentiles

from camber.formats.drive.recording import load_recording
from camber.integrity.service import IntegrityService
from camber.integrity.settings import IntegritySettings
from camber.replay.drive_inputs import prepare_drive
from camber.replay.single_process_replay import replay_in_one_process
from camber.runtime.bus import QueryFailed
from camber.runtime.inbox import Inbox
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME, inputs_of
from camber.schemas.codec import decode, encode, encoding_of
from camber.schemas.drive import load_manifest
from camber.validation.judged_fixes import JudgedFix, pair_fixes_with_verdicts

DRIVE_S = 120.0
LIVE_S = 90.0
ROUNDS = 5
GOAL_CPU_MS = 1.0
GOAL_P99_MS = 50.0
_WAKES = (("fix", "velocity", "receiver_integrity"), ("antenna_height",), ("motion", "pose"), ())
"""What comes together, in this order; the last wake of an epoch finds nothing."""

Wake = tuple[int, list[tuple[str, bytes]]]


class _Bus:
    """What `integrity` needs of a bus: it encodes what is published, everybody is there, nobody answers."""

    def __init__(self) -> None:
        self.now = 0
        self.published: list[Message] = []

    def now_ns(self) -> int:
        return self.now

    def is_alive(self, service: str) -> bool:
        return True

    def publish(self, name: str, message: Message) -> None:
        encode(message, source="integrity", sequence=len(self.published))
        self.published.append(message)

    def ask(self, name: str, request: Message) -> Message:
        raise QueryFailed("absent", "nobody answers")

    def count(self, name: str, n: int = 1) -> None: ...

    def issue(self, code: str, text: str) -> None: ...


def simulated(folder: Path) -> Path:
    """The canyon, made here."""
    camber(
        "simulate", "canyon", "--set", f"duration_s={DRIVE_S}", "--out", folder, "--quiet", timeout_s=300.0
    )
    return folder / "drive.toml"


def messages_of_the_judge(drive: Path, folder: Path) -> list[Wake]:
    """All that `integrity` receives of a drive, by wake, with its time: as bytes."""
    inputs = prepare_drive(load_manifest(drive), folder / "work")
    channels = [channel.name for channel in inputs_of("integrity")]
    recorded = replay_in_one_process(inputs, folder, channels=channels).recorded
    by_time: dict[int, dict[str, bytes]] = {}
    for name, items in recorded.items():
        for item in items:
            data = encode(item.message, source=item.source, sequence=item.sequence)
            by_time.setdefault(item.message.time_ns, {})[name] = data
    return [
        (time_ns, [(name, at_once[name]) for name in names if name in at_once])
        for time_ns, at_once in sorted(by_time.items())
        for names in _WAKES
    ]


def judge(wakes: list[Wake]) -> list[Message]:
    """One drive through the judge; what it published."""
    bus = _Bus()
    settings = IntegritySettings(vehicle="ego", clock="replay", upload=False)
    service = IntegrityService(settings, bus)  # type: ignore[arg-type]
    handlers = service.handlers()
    inboxes = {name: Inbox(channel=BY_NAME[name]) for name in handlers}
    encodings = {name: encoding_of(BY_NAME[name].message) for name in handlers}
    for time_ns, messages in wakes:
        bus.now = time_ns
        for name, data in messages:
            received = inboxes[name].open(data, encodings[name])
            message = None if received is None else inboxes[name].accept(received, time_ns, judge_age=False)
            if message is not None:
                handlers[name](message)
        service.advance(time_ns)
    return bus.published


def only_codec(wakes: list[Wake], published: list[Message]) -> None:
    """The same messages in and out, and nothing between."""
    for _, messages in wakes:
        for name, data in messages:
            decode(BY_NAME[name].message, data)
    for sequence, message in enumerate(published):
        encode(message, source="integrity", sequence=sequence)


def goal(what: str, at_most_ms: float, actual_ms: float) -> str:
    met = "met" if actual_ms <= at_most_ms else "NOT met"
    return f"goal: {what} at most {at_most_ms:g} ms: {met} with {actual_ms:.2f} ms"


def cpu(drive: Path, folder: Path) -> Figure:
    """By turns, the least of the rounds of each."""
    wakes = messages_of_the_judge(drive, folder)
    published = judge(wakes)
    epochs = sum(name == "fix" for _, messages in wakes for name, _ in messages)
    verdicts = Counter(getattr(message, "verdict", "position") for message in published)
    print(f"judge: {epochs} epochs, {dict(verdicts)}", file=sys.stderr)
    ours, peer = (
        1e3 * min(seconds) / epochs
        for seconds in zip(
            *(
                (
                    least_s(lambda: judge(wakes), rounds=1),
                    least_s(lambda: only_codec(wakes, published), rounds=1),
                )
                for _ in range(ROUNDS)
            ),
            strict=True,
        )
    )
    print(goal("CPU an epoch", GOAL_CPU_MS, ours))
    return lower("judge, CPU an epoch, bytes to bytes", "ms", ours, peer, "its messages decoded and encoded")


def asked(row: JudgedFix) -> bool:
    """Were other estimates asked for?"""
    return row.verdict is not None and (row.verdict.trials > 1 or "other estimates" in row.verdict.detail)


def latencies_ms(rows: list[JudgedFix]) -> list[float]:
    """From the arrival of a fix at the recorder to that of its verdict."""
    arrivals = [(row.fix_arrival_ns, row.verdict_arrival_ns) for row in rows]
    return [(then - first) / 1e6 for first, then in arrivals if first is not None and then is not None]


def latency(drive: Path, out: Path) -> list[Figure]:
    """Of all verdicts, and of those after other estimates."""
    options = ["--set", "positions=engine", "--set", f"end_s={LIVE_S}", "--quiet"]
    camber("replay", drive, "--processes", "--speed", 1, "--out", out, *options, timeout_s=LIVE_S + 240.0)
    messages, _ = load_recording(out / "recording.mcap")
    rows = pair_fixes_with_verdicts(messages["fix"], messages["verdict"])
    again = [row for row in rows if asked(row)]
    most = max((row.verdict.trials - 1 for row in again if row.verdict is not None), default=0)
    factor = json.loads((out / "summary.json").read_text())["speed_factor"]
    print(
        f"judge: {len(rows)} verdicts at {factor:.2f} times real time, {len(again)} of them after at most {most} "
        f"other estimates, the last {max(latencies_ms(rows)):.1f} ms after its fix",
        file=sys.stderr,
    )
    by_kind = {"all": latencies_ms(rows), "after other estimates": latencies_ms(again)}
    p99 = float(np.percentile(by_kind["all"], 99))
    print(goal("p99", GOAL_P99_MS, p99))
    return [
        figure
        for name, of in by_kind.items()
        if of
        for figure in percentiles(f"engine's fix to verdict, {name}", "ms", of, GOAL_P99_MS, "goal, p99")
    ]


def figures() -> list[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        drive = simulated(folder / "drive")
        return [cpu(drive, folder / "judge"), *latency(drive, folder / "live")]


if __name__ == "__main__":
    print(figures())
