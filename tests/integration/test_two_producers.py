"""A second producer of a channel is named within two seconds, and nothing is confirmed on its word."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from camber.runtime.bus import Bus, QueryFailed
from camber.runtime.session import open_session
from camber.runtime.subscription import Subscription
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import encode, encoding_of
from camber.schemas.integrity import Verdict
from camber.schemas.motion import Motion
from camber.schemas.pose import Pose, Road
from camber.schemas.road import ElevationReply, ElevationRequest
from support.judging import ROAD_M, SPEED_M_S, antenna, fix, pose, road
from support.running import (
    CLOCK,
    bus_of,
    camber_started,
    client_of,
    health_of,
    loopback_router,
    settings_file,
    wait_until,
)

pytestmark = pytest.mark.slow

NAMED_WITHIN_S = 2.0
WRONG_M = 1.0
TRUSTED = ("confirmed", "verified")


class Vehicle(threading.Thread):
    """Everything but the judge, ten times a second; `wrong`: its fixes are a metre too high."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(daemon=True)
        names = ("vehicle", "gnss", "localizer", "antenna_height", "map_server")
        self.buses = {name: bus_of(endpoint, name) for name in names}
        for bus in self.buses.values():
            bus.announce()
        self.wrong, self.wrong_ids = False, set[int]()
        self._begin_s, self._ended = time.monotonic(), threading.Event()

    def epoch(self) -> tuple[float, int]:
        """Of the drive now, and its time."""
        return (time.monotonic() - self._begin_s) * 5.0, CLOCK.now_ns()

    def run(self) -> None:
        while not self._ended.wait(0.1):
            k, now_ns = self.epoch()
            fix_id = now_ns // 1_000_000
            if self.wrong:
                self.wrong_ids.add(fix_id)
            self.buses["vehicle"].publish("motion", Motion(time_ns=now_ns, wheel_speed_m_s=SPEED_M_S))
            self.buses["antenna_height"].publish("antenna_height", antenna(k, time_ns=now_ns))
            self.buses["localizer"].publish("pose", pose(k, time_ns=now_ns))
            up_m = WRONG_M if self.wrong else 0.0
            self.buses["gnss"].publish("fix", fix(k, time_ns=now_ns, fix_id=fix_id, up_m=up_m))

    def end(self) -> None:
        self._ended.set()
        self.join()
        for bus in self.buses.values():
            bus.close()


class Verdicts(threading.Thread):
    """All verdicts with their arrival, of every judge."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(daemon=True)
        self.received: list[tuple[float, Verdict]] = []
        self._ended = threading.Event()
        self._subscription = Subscription("verdict", vehicle="car", connect=[endpoint], live=False)

    def run(self) -> None:
        with self._subscription as subscription:
            while not self._ended.is_set():
                verdict = subscription.next(0.1)
                if verdict is not None:
                    self.received.append((time.monotonic(), verdict))

    def trusted(self, from_s: float = 0.0) -> list[Verdict]:
        return [v for at_s, v in list(self.received) if at_s >= from_s and v.verdict in TRUSTED]

    def end(self) -> None:
        self._ended.set()
        self.join()


@pytest.fixture
def endpoint() -> Iterator[str]:
    with loopback_router() as endpoint:
        yield endpoint


def judge_file(folder: Path, endpoint: str) -> Path:
    return settings_file(
        folder / "integrity.toml", endpoint, "upload = false", 'horizontal_reference = "assumed"'
    )


@contextmanager
def judged(folder: Path, endpoint: str) -> Iterator[tuple[Vehicle, Verdicts]]:
    """A vehicle with a judge, from when right fixes are confirmed."""
    with ExitStack() as stack:
        log = stack.enter_context((folder / "integrity.log").open("w"))
        stack.enter_context(
            camber_started("integrity", "--config", judge_file(folder, endpoint), stdout=log, stderr=log)
        )
        vehicle, verdicts = Vehicle(endpoint), Verdicts(endpoint)
        for thread in (verdicts, vehicle):
            thread.start()
            stack.callback(thread.end)
        wait_until(verdicts.trusted, timeout_s=60.0, why="no right fix is confirmed")
        yield vehicle, verdicts


def high_pose(vehicle: Vehicle) -> Pose:
    """A pose with a road that makes the wrong fixes look right."""
    k, now_ns = vehicle.epoch()
    return pose(k, time_ns=now_ns, road=road(elevation_m=ROAD_M + WRONG_M))


def second_localizer(vehicle: Vehicle, endpoint: str, ended: threading.Event) -> None:
    bus = bus_of(endpoint, "localizer")
    while not ended.wait(0.05):
        bus.publish("pose", high_pose(vehicle))
    bus.close()


def replayed_poses(vehicle: Vehicle, endpoint: str, ended: threading.Event) -> None:
    """As a player of recorded bytes publishes them: the producer's name, its old numbers, and no session."""
    session: Any = open_session(client_of(endpoint).zenoh)
    sequence = 0
    while not ended.wait(0.05):
        data = encode(high_pose(vehicle), source="localizer", sequence=sequence)
        session.put(BY_NAME["pose"].key_for("car"), data, encoding=encoding_of(Pose))
        sequence += 1
    session.close()


def is_named(endpoint: str, channel: str) -> bool:
    """Whether the judge reports two producers of a channel."""
    issues = health_of(endpoint, "integrity").issues
    return any(issue.code == "two_producers" and issue.text.startswith(f"{channel}: ") for issue in issues)


@pytest.mark.parametrize("second", [second_localizer, replayed_poses])
def test_a_second_pose_is_named_and_confirms_nothing(second: Any, endpoint: str, tmp_path: Path) -> None:
    with judged(tmp_path, endpoint) as (vehicle, verdicts):
        ended = threading.Event()
        thread = threading.Thread(target=second, args=(vehicle, endpoint, ended), daemon=True)
        vehicle.wrong = True
        began_s = time.monotonic()
        thread.start()
        wait_until(lambda: is_named(endpoint, "pose"), timeout_s=NAMED_WITHIN_S, why="not named")
        time.sleep(max(began_s + 3.0 - time.monotonic(), 0.0))
        blind_s = time.monotonic()
        time.sleep(1.0)
        assert verdicts.trusted(blind_s) == []
        ended.set()
        thread.join()
        vehicle.wrong = False
        again_s = time.monotonic()
        wait_until(lambda: verdicts.trusted(again_s), timeout_s=30.0, why="not confirmed again")
        assert vehicle.wrong_ids
        assert not {verdict.fix_id for verdict in verdicts.trusted()} & vehicle.wrong_ids


def test_two_judges_are_named_by_who_reads_verdicts_and_neither_is_used(
    endpoint: str, tmp_path: Path
) -> None:
    with judged(tmp_path, endpoint), Subscription("verdict", vehicle="car", connect=[endpoint]) as consumer:
        assert consumer.next(5.0) is not None
        with camber_started(
            "integrity", "--config", judge_file(tmp_path / "second", endpoint), stdout=None, stderr=None
        ):
            wait_until(
                lambda: consumer.next(0.05) is None and consumer.refused["new_producer"],
                timeout_s=60.0,
                why="the second judge has not begun",
            )
            began_s = time.monotonic()
            while not consumer.refused["two_producers"]:
                consumer.next(0.05)
                assert time.monotonic() - began_s < NAMED_WITHIN_S
            end_s = time.monotonic() + 2.0
            while time.monotonic() < end_s:
                assert consumer.next(0.05) is None
        wait_until(lambda: consumer.next(0.05), timeout_s=10.0, why="the remaining judge is not used")


def test_two_that_answer_are_named_and_neither_is_used(endpoint: str) -> None:
    buses = [bus_of(endpoint, name) for name in ("localizer", "map_server", "map_server")]
    asker, *answerers = buses
    ended = threading.Event()

    def answer(bus: Bus) -> None:
        while not ended.is_set():
            bus.next_event(0.02)
            for query in bus.pop_queries("elevation"):
                with query:
                    unknown = Road(status="unknown", reason="map_missing")
                    bus.reply(query, ElevationReply(time_ns=CLOCK.now_ns(), road=unknown))

    def ask() -> str:
        place = {"latitude_rad": 0.6, "longitude_rad": 2.4}
        try:
            asker.ask("elevation", ElevationRequest(time_ns=CLOCK.now_ns(), **place))
        except QueryFailed as error:
            return error.reason
        return "answered"

    with ExitStack() as stack:
        stack.callback(lambda: [bus.close() for bus in buses])
        stack.callback(ended.set)
        asker.announce()
        for bus in answerers:
            bus.announce()
        answerers[0].answer(BY_NAME["elevation"])
        threading.Thread(target=answer, args=(answerers[0],), daemon=True).start()
        wait_until(lambda: ask() == "answered", timeout_s=10.0, why="no answer")
        assert "refused" not in {ask() for _ in range(10)}
        answerers[1].answer(BY_NAME["elevation"])
        threading.Thread(target=answer, args=(answerers[1],), daemon=True).start()
        began_s = time.monotonic()
        while not any(issue.code == "two_producers" for issue in asker.issues()):
            ask()
            time.sleep(0.05)
            assert time.monotonic() - began_s < NAMED_WITHIN_S
        outcomes = set()
        for _ in range(20):
            outcomes.add(ask())
            time.sleep(0.05)
        assert "refused" in outcomes
        assert "answered" not in outcomes
