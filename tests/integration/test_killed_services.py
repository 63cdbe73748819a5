"""Each service is killed while a drive is replayed through real processes; the replay starts it again.

Measured in the drive's own time, so that a slow machine changes nothing: what the judge says while a service is
away, and how many epochs with a right fix pass from its return to the first confirmed position.
"""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest

from camber.replay.short_drive import RATE_HZ, SCHEDULE, write_short_drive
from camber.runtime.subscription import Subscription
from camber.schemas.channels import BY_NAME
from support.running import (
    drive_s,
    endpoint_of,
    kill,
    process_ids,
    recorded,
    replaying,
    summary_of,
    wait_until,
)

pytestmark = pytest.mark.slow

END_S = 110.0
RETURN_S = 5.0  # of right fixes
OLDEST_S = {
    "gnss": BY_NAME["fix"].max_age_s,
    "antenna_height": BY_NAME["antenna_height"].max_age_s,
    "map_server": BY_NAME["elevation"].max_age_s,
    "localizer": BY_NAME["pose"].max_age_s,
}
REASON = {service: f"{service}_absent" for service in OLDEST_S}
"""Of the judge's *unknown* while a service is away whose last message is too old."""
EPOCH_S = 1.0 / RATE_HZ


def right(time_s: float) -> bool:
    return not any(begin <= round(time_s, 3) < end for begin, end, _ in SCHEDULE)


def right_for(from_s: float, length_s: float) -> bool:
    return not any(begin < from_s + length_s and from_s < end for begin, end, _ in SCHEDULE)


def drive_without_given_pose(folder: Path) -> Path:
    """Makes a localizer that returns start from fixes, as on the road."""
    manifest = write_short_drive(folder)
    manifest.write_text(manifest.read_text().partition("[initial_pose]")[0])
    return manifest


@contextmanager
def sabotaging(manifest: Path, out: Path, end_s: float, speed: float) -> Iterator[Saboteur]:
    with (
        replaying(manifest, out, end_s, speed) as replay,
        Subscription("verdict", vehicle="demo", connect=[endpoint_of(out)], live=False) as listener,
    ):
        yield Saboteur(replay, out, listener)


@dataclass
class Kill:
    service: str
    last_message_s: float


class Saboteur:
    """Kills one service after the other, each as soon as positions are confirmed again."""

    def __init__(self, replay: subprocess.Popen[str], out: Path, listener: Subscription) -> None:
        self.replay, self.out, self.listener = replay, out, listener
        self.kills: list[Kill] = []

    def wait_for_end(self) -> str:
        """Output of the replay."""
        output, _ = self.replay.communicate(timeout=240.0)
        assert self.replay.returncode == 0, output
        return output

    def sabotage(self, service: str, *, from_s: float) -> None:
        kill_s = self.wait_for_good_time(from_s, 1.5 + OLDEST_S.get(service, 0.0))
        pid = process_ids(self.out)[service]
        kill(pid)
        self.kills.append(Kill(service, kill_s))
        if service in REASON:
            self.keep_away_until_the_judge_says_so(service, pid)
        else:
            wait_until(lambda: process_ids(self.out)[service] != pid, timeout_s=60.0, why="not started again")

    def keep_away_until_the_judge_says_so(self, service: str, pid: int) -> None:
        """It may be back before its last message is too old: then it is killed again."""
        since = time.monotonic()
        while self.next_verdict().reason != REASON[service]:
            now = process_ids(self.out)[service]
            if now != pid and time.monotonic() - since > 0.3:
                kill(now)
                pid, since = now, time.monotonic()

    def wait_for_good_time(self, from_s: float, right_s: float) -> float:
        """Fixes are right for longer than the age limit of the last message of the service."""
        confirmed = 0
        while True:
            verdict = self.next_verdict()
            confirmed = confirmed + 1 if verdict.verdict == "confirmed" else 0
            now_s = drive_s(verdict.time_ns)
            if confirmed >= 3 and now_s >= from_s and right_for(now_s, right_s):
                return now_s

    def next_verdict(self, timeout_s: float = 20.0):
        verdict = self.listener.next(timeout_s=timeout_s)
        assert verdict is not None, f"the judge is silent; killed so far: {self.kills}"
        return verdict


def test_without_a_service_the_judge_says_unknown_and_why_and_confirms_again_when_it_is_back(tmp_path):
    manifest, out = drive_without_given_pose(tmp_path / "drive"), tmp_path / "out"
    with sabotaging(manifest, out, END_S, 2.0) as saboteur:
        for service in ("localizer", "gnss", "map_update", "antenna_height", "map_server", "integrity"):
            saboteur.sabotage(service, from_s=16.0)  # the vehicle moves: a start needs a direction
        output = saboteur.wait_for_end()
    summary = summary_of(out)
    assert summary["confirmed"]["wrong"] == 0
    assert summary["confirmed"]["count"] > 100
    verdicts = [item.message for item in recorded(out)["verdict"]]
    for event in saboteur.kills:
        check_outage(event, verdicts)
        print(event, f"{right_epochs_to_return(event, verdicts)} right epochs from return to confirmed")
    for event in saboteur.kills:
        assert f"{event.service} ended (signal SIGKILL) and was started again" in output


def check_outage(event: Kill, verdicts) -> None:
    after = [v for v in verdicts if drive_s(v.time_ns) > event.last_message_s + EPOCH_S]
    assert right_epochs_to_return(event, verdicts) <= RETURN_S * RATE_HZ
    if event.service not in REASON:
        return
    outage = [v for v in after if drive_s(v.time_ns) <= away(event, verdicts)[1]]
    too_old_s = event.last_message_s + EPOCH_S + OLDEST_S[event.service]
    for verdict in outage:
        if drive_s(verdict.time_ns) > too_old_s:
            assert verdict.verdict == "unknown", (event, drive_s(verdict.time_ns), verdict)
    # A fix that is a float, or none, has a reason of its own; every right one has this.
    reasons = {v.reason for v in outage if drive_s(v.time_ns) > too_old_s and right(drive_s(v.time_ns))}
    assert reasons == {REASON[event.service]}, event


def away(event: Kill, verdicts) -> tuple[float, float]:
    """From when to when the judge missed a service; for others, the time without a verdict, or none at all."""
    times = [drive_s(v.time_ns) for v in verdicts if drive_s(v.time_ns) >= event.last_message_s]
    if event.service in REASON:
        missed = [drive_s(v.time_ns) for v in verdicts if v.reason == REASON[event.service]]
        return min(missed), max(missed)
    gaps = [(a, b) for a, b in pairwise(times) if b - a > 2.0 * EPOCH_S]
    return gaps[0] if gaps and event.service == "integrity" else (event.last_message_s, event.last_message_s)


def right_epochs_to_return(event: Kill, verdicts) -> int:
    """Epochs with a right fix between a service's return and the first position confirmed after it."""
    since_s = away(event, verdicts)[1]
    later = [v for v in verdicts if drive_s(v.time_ns) > since_s]
    first = next(v for v in later if v.verdict.startswith("confirmed"))
    return sum(right(drive_s(v.time_ns)) for v in later if v.time_ns < first.time_ns)


def test_a_replay_goes_on_without_a_frozen_service_until_it_resumes(tmp_path):
    manifest, out = drive_without_given_pose(tmp_path / "drive"), tmp_path / "out"
    with sabotaging(manifest, out, END_S, 3.0) as saboteur:
        frozen_s = saboteur.wait_for_good_time(8.0, 3.5)
        pid = process_ids(out)["antenna_height"]
        kill(pid, signal.SIGSTOP)
        # Its links stay open: only the end of its lease shows it to the others, and nothing is judged until then.
        # Afterwards the replay makes up for the time it stood, to some 70 s of the drive.
        began = time.monotonic()
        while saboteur.next_verdict(timeout_s=60.0).reason != "antenna_height_absent":
            assert time.monotonic() - began < 60.0, "the barrier waits for a frozen service"
        kill(pid, signal.SIGCONT)
        back_s = saboteur.wait_for_good_time(frozen_s, 1.5)
        saboteur.wait_for_end()
    assert back_s > frozen_s
    assert summary_of(out)["confirmed"]["wrong"] == 0


def test_a_pose_given_for_the_start_is_not_believed_by_a_localizer_that_returns_in_mid_drive(tmp_path):
    out = tmp_path / "out"
    # Beside other tests a localizer takes up to ten seconds to come back: half a minute of the drive at this speed.
    with sabotaging(write_short_drive(tmp_path / "drive"), out, END_S, 3.0) as saboteur:
        saboteur.sabotage("localizer", from_s=35.8)
        saboteur.wait_for_end()
    verdicts = [item.message for item in recorded(out)["verdict"]]
    last_s = max(drive_s(v.time_ns) for v in verdicts if v.verdict == "confirmed")
    assert last_s > 60.0
