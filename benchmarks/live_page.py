"""The live page with an hour of track and a map of a million surfaces, in Chromium without a graphics processor.

A router, `camber live` and a publisher of 10 epochs a second are processes or sessions of their own; the page is drawn
by software as in CI. The peer of each figure is its goal, as there is no other page of the same data. Times of the page
are by its own clock, which is this machine's, as the publisher's is. Beside the length of the longest task stands the
CPU of the one that took most: on a machine that does other things, tasks wait for a core and for what draws.
"""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from elevation import MADE_NS, City
from figure import Figure, lower
from judge import simulated
from websockets.sync.client import connect

from camber.formats.drive.mcap_recorder import Recorder
from camber.formats.drive.recording import load_recording
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.live.history import HOUR_ROWS
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from camber.schemas.base import Message
from camber.schemas.codec import encode, encoding_of
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Position, Verdict
from camber.schemas.pose import Pose, Road
from camber.validation.judged_fixes import pair_fixes_with_verdicts
from support.browser import PROGRAM, chromium, served_address
from support.running import (
    CLOCK,
    camber_started,
    endpoint_of,
    loopback_router,
    process_ids,
    replaying,
    wait_until,
)

VEHICLE = "car"
STREETS, SURFACES = 500, 1000
"""Eastwards and northwards, each of so many surfaces: a million in 20 km by 20 km."""
RADIUS_M, SPEED_M_S = 1500.0, 10.0
"""Of the circle that is driven: the page shows the whole of it at zoom 14, where a screen has most surfaces."""
EPOCH_NS = 100_000_000
PER_PUT, PUT_S = 5, 0.01
"""Epochs of the hour that are published together and how often: 2000 messages a second, half of what is a flood."""
MEASURED_S = 20.0
SETTLED_AFTER_S = 5.0
"""After the first frame: until then the page takes the hour and is not open."""
BROWSERS = 10
PREPARED_S = 240.0
PHASE_S, SETTLED_S, JUDGED_S = 20.0, 6.0, 120.0
"""Of the judge: with and without the page by turns; what follows a change is left out, as the page starts in it."""
GOAL_PIXEL_MS, GOAL_TASK_MS, GOAL_DRAWN_S = 200.0, 100.0, 2.0
GOAL_CPU, GOAL_MB, GOAL_JUDGE = 5.0, 150.0, 1.1
LEAST_TASK_MS = 50.0
"""Shorter ones are not reported (W3C Long Tasks API)."""

_WATCH = """(() => {
  const seen = window.bench = { tasks: [], drawn: [], roads: null, last: 0 }, after = new MessageChannel();
  new PerformanceObserver(list => seen.tasks.push(...list.getEntries().map(task => [task.startTime, task.duration])))
    .observe({ type: "longtask", buffered: true });
  // A message is read after the frame in which it was sent.
  after.port1.onmessage = ({ data }) => {
    if (data) seen.drawn.push([data, Date.now() / 1000]);
    else seen.roads ??= performance.now();
  };
  const watch = () => {
    const map = window.camber?.map.map;
    if (!map) { requestAnimationFrame(watch); return; }
    map.on("render", () => {
      const { view, store } = camber, { last } = store.tables.verdict;
      if (last > seen.last && view.end >= last) { seen.last = last; after.port2.postMessage(last); }
      if (seen.roads === null && map.getZoom() > 6 && map.areTilesLoaded()) after.port2.postMessage(0);
    });
  };
  requestAnimationFrame(watch);
})()"""


class HourOfDriving:
    """Messages of a vehicle on a circle in the middle of the city."""

    def __init__(self) -> None:
        turn_rad = np.arange(HOUR_ROWS) * (EPOCH_NS / 1e9) * SPEED_M_S / RADIUS_M
        middle_m = STREETS * 20.0
        self.yaw_rad = np.arctan2(np.cos(turn_rad), -np.sin(turn_rad))
        self.latitude_rad, self.longitude_rad, _ = City.geodetic(
            middle_m + RADIUS_M * np.cos(turn_rad), middle_m + RADIUS_M * np.sin(turn_rad)
        )
        self.difference_m = np.random.default_rng(7).normal(0.0, 0.03, HOUR_ROWS)

    def epoch(self, k: int, time_ns: int) -> Iterator[tuple[str, str, Message]]:
        """Channel, key and message of each."""
        row = k % HOUR_ROWS
        place = {
            "latitude_rad": float(self.latitude_rad[row]),
            "longitude_rad": float(self.longitude_rad[row]),
        }
        covariance = (1e-4, 0.0, 0.0, 1e-4, 0.0, 4e-4)
        yaw_rad, common = float(self.yaw_rad[row]), {"time_ns": time_ns}
        messages: dict[str, Message] = {
            "localizer/pose": Pose(
                **common,
                **place,
                mode="scan_match",
                provenance="scan_match",
                yaw_rad=yaw_rad,
                covariance_east_north_yaw=(0.04, 0.0, 0.0, 0.04, 0.0, 1e-4),
                speed_m_s=SPEED_M_S,
                horizontal_basis="scan_match",
                road=Road(status="unknown"),
            ),
            "gnss/fix": Fix(
                **common,
                **place,
                fix_id=k,
                origin="receiver",
                quality="fixed",
                height_m=51.6,
                covariance_enu_m2=covariance,
                satellites=12 + k // 50 % 9,
                ratio=5.0,
            ),
            "integrity/verdict": Verdict(
                **common,
                fix_id=k,
                verdict="erroneous" if k % 97 < 3 else "confirmed",
                reason="height_disagrees" if k % 97 < 3 else "height_agrees",
                detail="height 0.02 m off, tolerance 0.12 m",
                height_difference_m=float(self.difference_m[row]) + (0.6 if k % 97 < 3 else 0.0),
                tolerance_m=0.12,
            ),
            "integrity/position": Position(
                **common,
                **place,
                source="rtk",
                usable=True,
                height_m=51.6,
                yaw_rad=yaw_rad,
                semi_major_99_m=0.05,
                semi_minor_99_m=0.04,
                orientation_rad=0.3,
                horizontal_protection_level_m=0.4 + 0.3 * math.sin(k / 500.0),
                vertical_protection_level_m=0.5,
                alert_limit_m=1.5,
                vertical_alert_limit_m=2.0,
            ),
        }
        for key, message in messages.items():
            yield key.partition("/")[2], key, message


class PublishingVehicle:
    """An hour at once, then 10 epochs a second until the end."""

    def __init__(self, endpoint: str, hour: HourOfDriving) -> None:
        self._session = open_session(ZenohSettings(mode="client", connect=[endpoint]))
        self._hour, self._ended = hour, threading.Event()
        self.published_s: list[float] = []
        """Unix times of verdicts, at which they were published."""
        self._thread = threading.Thread(target=self._drive, daemon=True)

    def publish_hour(self) -> None:
        """Epochs up to now, fifty times as fast as the clock at most."""
        begin_ns = CLOCK.now_ns() - HOUR_ROWS * EPOCH_NS
        for k in range(HOUR_ROWS):
            self._put(k, begin_ns + k * EPOCH_NS)
            if k % PER_PUT == PER_PUT - 1:
                time.sleep(PUT_S)

    def start(self) -> None:
        self._thread.start()

    def end(self) -> None:
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        self._session.close()

    def _drive(self) -> None:
        k = HOUR_ROWS
        while not self._ended.wait(EPOCH_NS / 1e9 - time.time() % (EPOCH_NS / 1e9)):
            time_ns = CLOCK.now_ns()
            self._put(k, time_ns)
            self.published_s.append(unix_ns_from_gps_ns(time_ns) / 1e9)
            k += 1

    def _put(self, k: int, time_ns: int) -> None:
        for _, key, message in self._hour.epoch(k, time_ns):
            data = encode(message, source=key.partition("/")[0], sequence=k)
            self._session.put(f"camber/v1/{VEHICLE}/{key}", data, encoding=encoding_of(type(message)))


def write_city(folder: Path) -> Path:
    """The release of a million surfaces."""
    City(STREETS, SURFACES).write(folder)
    return folder


def write_recording(path: Path, hour: HourOfDriving) -> Path:
    recorder = Recorder(path)
    for k in range(HOUR_ROWS):
        time_ns = MADE_NS + k * EPOCH_NS
        for channel, key, message in hour.epoch(k, time_ns):
            data = encode(message, source=key.partition("/")[0], sequence=k)
            recorder.add(channel, data, key=f"camber/v1/{VEHICLE}/{key}", arrival_ns=time_ns)
    recorder.close()
    return path


class MeasuredProcess:
    """CPU time and memory of a process."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._since = self.cpu_s, time.monotonic()

    @property
    def cpu_s(self) -> float:
        fields = Path(f"/proc/{self._pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def share_percent(self) -> float:
        """Of a core, since this was made."""
        return 100.0 * (self.cpu_s - self._since[0]) / (time.monotonic() - self._since[1])

    def memory_mb(self) -> float:
        """Resident, now."""
        lines = Path(f"/proc/{self._pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024.0


class ShownPage:
    """A page that keeps what `_WATCH` sees of it, traced until `look`."""

    def __init__(self, browser: Any, address: str) -> None:
        self._browser = browser
        self.page = browser.new_page(viewport={"width": 1440, "height": 900})
        self.page.add_init_script(_WATCH)
        browser.start_tracing(page=self.page, categories=["toplevel"])
        self.page.goto(address)

    def wait_for(self, expression: str, timeout_s: float) -> None:
        wait_until(lambda: self.page.evaluate(expression), timeout_s=timeout_s, why=expression)

    def wait_for_hour(self) -> None:
        """Nearly all of it: a loaded machine may leave out some of it as a flood."""
        rows = int(0.95 * HOUR_ROWS)
        self.wait_for(f"window.camber?.store.tables.verdict?.length >= {rows}", 60.0)

    def look(self, what: str) -> tuple[list[Figure], dict[str, Any]]:
        """Its longest task, when its roads were drawn first, and all that was seen; closes it."""
        seen = self.page.evaluate("bench")
        cpu_ms = most_cpu_ms(json.loads(self._browser.stop_tracing()))
        self.page.close()
        assert seen["roads"] is not None, "no roads were drawn"
        tasks = sorted((round(duration) for _, duration in seen["tasks"]), reverse=True)
        print(f"live_page, {what}: tasks of {tasks[:20]} ms, {load()}", file=sys.stderr)
        longest_ms = max([LEAST_TASK_MS, *tasks])
        return [
            lower(f"live page, longest task, {what}", "ms", longest_ms, GOAL_TASK_MS, "goal"),
            lower(f"live page, most CPU of a task, {what}", "ms", cpu_ms, GOAL_TASK_MS, "goal"),
            lower(f"live page, roads drawn, {what}", "s", seen["roads"] / 1e3, GOAL_DRAWN_S, "goal"),
        ], seen


def most_cpu_ms(trace: dict[str, Any]) -> float:
    """Of a task of the thread that runs the page, by a trace of Chromium."""
    events = trace["traceEvents"]
    pages = {
        (event["pid"], event["tid"])
        for event in events
        if event["name"] == "thread_name" and event["args"]["name"] == "CrRendererMain"
    }
    return 1e-3 * max(
        event["tdur"] for event in events if (event["pid"], event.get("tid")) in pages and "tdur" in event
    )


def load() -> str:
    return f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"


def pixel_latencies_ms(published_s: list[float], drawn: list[tuple[float, float]]) -> list[float]:
    """From publishing to the first frame whose newest verdict is that one or a later one."""
    newest_s, at_s = np.array(drawn).T
    times_s = np.array(published_s)
    times_s = times_s[(times_s > at_s[0] + SETTLED_AFTER_S) & (times_s <= newest_s[-1])]
    print(f"live_page: a frame every {1e3 * float(np.median(np.diff(at_s))):.0f} ms", file=sys.stderr)
    return [float(x) for x in 1e3 * (at_s[np.searchsorted(newest_s, times_s - 1e-6)] - times_s)]


def on_the_bus(browser: Any, release: Path, hour: HourOfDriving) -> list[Figure]:
    """A vehicle that has driven for an hour: the page as it opens, and all of the hour with the town around it."""
    with ExitStack() as ends:
        endpoint = ends.enter_context(loopback_router())
        command = ("live", "--connect", endpoint, "--vehicle", VEHICLE, "--map", release, "--port", 0)
        server = ends.enter_context(camber_started(*command))
        address = served_address(server)
        with connect(address.replace("http", "ws") + "stream", max_size=None) as stream:
            wait_until(
                lambda: '"receiving"' in str(stream.recv()), timeout_s=30.0, why="it is not on the bus"
            )
        vehicle = PublishingVehicle(endpoint, hour)
        ends.callback(vehicle.end)
        vehicle.publish_hour()
        vehicle.start()
        shown = ShownPage(browser, address)
        shown.wait_for_hour()
        process = MeasuredProcess(server.pid)
        shown.page.wait_for_timeout(1e3 * MEASURED_S)
        cpu = process.share_percent()
        figures, seen = shown.look("on the bus")
        latencies_ms = pixel_latencies_ms(vehicle.published_s, seen["drawn"])
        print(f"live_page: {len(latencies_ms)} verdicts drawn, {load()}", file=sys.stderr)
        pixel_ms = float(np.percentile(latencies_ms, 95))
        place = "/".join(
            f"{math.degrees(axis.mean()):.6f}" for axis in (hour.latitude_rad, hour.longitude_rad)
        )
        shown = ShownPage(browser, f"{address}#span=3600&follow=0&map=14/{place}/0")
        shown.wait_for_hour()
        shown.page.wait_for_timeout(1e3 * MEASURED_S)
        return [
            lower("live page, bus to pixel, p95", "ms", pixel_ms, GOAL_PIXEL_MS, "goal"),
            *figures,
            *shown.look("an hour of the bus at zoom 14")[0],
            lower("camber live, CPU with one browser", "%", cpu, GOAL_CPU, "goal"),
            lower("camber live, memory", "MB", process.memory_mb(), GOAL_MB, "goal"),
        ]


def of_a_recording(browser: Any, release: Path, recording: Path) -> list[Figure]:
    """From the opening of the page, while the recording is read, until all of it is shown."""
    with camber_started("live", recording, "--map", release, "--port", 0) as server:
        shown = ShownPage(browser, served_address(server))
        shown.wait_for("window.camber?.store.complete && camber.map.ready", 120.0)
        shown.page.wait_for_timeout(5e3)
        return shown.look("a recording of an hour")[0]


@contextmanager
def browsers_of(endpoint: str, vehicle: str) -> Iterator[None]:
    """`camber live` and ten readers of its stream."""
    ended = threading.Event()

    def read(address: str) -> None:
        with connect(address, max_size=None) as stream:
            while not ended.is_set():
                stream.recv()

    with camber_started("live", "--connect", endpoint, "--vehicle", vehicle, "--port", 0) as server:
        address = served_address(server).replace("http", "ws") + "stream"
        threads = [threading.Thread(target=read, args=(address,), daemon=True) for _ in range(BROWSERS)]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            ended.set()
            for thread in threads:
                thread.join(5.0)


def judge_with_browsers(folder: Path) -> Figure:
    """A fix to its verdict in a replay at the speed of the clock, with ten browsers and without the page by turns."""
    out = folder / "out"
    drive = simulated(folder / "drive")
    times_ns: dict[bool, list[tuple[int, int]]] = {False: [], True: []}
    with replaying(drive, out, JUDGED_S, 1, "--set", "positions=engine") as replay:
        wait_until(lambda: process_ids(out), timeout_s=PREPARED_S, why="no services were started")
        endpoint = endpoint_of(out)
        vehicle = tomllib.loads((out / "config" / "gnss.toml").read_text())["vehicle"]
        while replay.poll() is None:
            for with_browsers in (False, True):
                with ExitStack() as ends:
                    if with_browsers:
                        ends.enter_context(browsers_of(endpoint, vehicle))
                    began_ns = time.time_ns()
                    time.sleep(PHASE_S)
                    times_ns[with_browsers].append((began_ns + int(SETTLED_S * 1e9), time.time_ns()))
    messages, _ = load_recording(out / "recording.mcap")
    rows = pair_fixes_with_verdicts(messages["fix"], messages["verdict"])
    pairs = [(row.fix_arrival_ns, row.verdict_arrival_ns) for row in rows]
    p99_ms = {}
    for with_browsers, spans in times_ns.items():
        latencies = [
            (verdict - fix) / 1e6
            for fix, verdict in pairs
            if fix is not None and verdict is not None and any(begin <= fix < end for begin, end in spans)
        ]
        p99_ms[with_browsers] = float(np.percentile(latencies, 99))
        print(
            f"live_page: {len(latencies)} verdicts, browsers {with_browsers}, median {np.median(latencies):.2f}, "
            f"p99 {p99_ms[with_browsers]:.2f} ms, {load()}",
            file=sys.stderr,
        )
    ratio = p99_ms[True] / p99_ms[False]
    return lower(
        "judge, fix to verdict, p99 with ten browsers beside without", "times", ratio, GOAL_JUDGE, "goal"
    )


def figures() -> list[Figure]:
    if PROGRAM is None:
        print("live_page: not measured, needs Debian's chromium", file=sys.stderr)
        return []
    hour = HourOfDriving()
    with tempfile.TemporaryDirectory() as name, chromium() as browser:
        folder = Path(name)
        release = write_city(folder / "map")
        return [
            *on_the_bus(browser, release, hour),
            *of_a_recording(browser, release, write_recording(folder / "hour.mcap", hour)),
            judge_with_browsers(folder),
        ]


if __name__ == "__main__":
    print(figures())
