"""`camber foxglove`: a viewer that is not ours gets fixes and the track live, at their UTC."""

from __future__ import annotations

import json
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from camber.formats.foxglove.protobuf import decode
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.replay.short_drive import write_short_drive
from camber.runtime.bus import Bus
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Position
from support.running import CLOCK, bus_of, camber, camber_started, loopback_router

pytest.importorskip("foxglove", reason="camber[foxglove] is not installed")
connect = pytest.importorskip("websockets.sync.client").connect


@pytest.fixture
def endpoint() -> Iterator[str]:
    with loopback_router() as endpoint:
        yield endpoint


class Viewer:
    """A client of Foxglove's WebSocket protocol: subscribes to all topics, keeps what comes by topic."""

    def __init__(self, url: str) -> None:
        self.channels: dict[int, dict[str, Any]] = {}
        self.received: dict[str, list[tuple[int, bytes]]] = {}
        self.times_ns: list[int] = []
        self.url = url
        self._subscribed_s = time.monotonic()
        self._connection = connect(url, subprotocols=["foxglove.sdk.v1"], open_timeout=10.0)

    def __enter__(self) -> Viewer:
        self._socket = self._connection.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.__exit__(None, None, None)

    def listen(self, seconds: float) -> None:
        if time.monotonic() - self._subscribed_s > 1.0:
            self._subscribe_again()
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0.0:
            try:
                data = self._socket.recv(timeout=left_s)
            except TimeoutError:
                return
            self._take(data)

    def _subscribe(self, ids: list[int]) -> None:
        self._subscribed_s = time.monotonic()
        subscriptions = [{"id": number, "channelId": number} for number in ids]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))

    def _subscribe_again(self) -> None:
        """To silent topics: on a loaded machine foxglove-sdk 0.30.3 loses a subscription that comes at once.

        It advertises a channel before its context knows it.
        """
        silent = [
            number for number, channel in self.channels.items() if channel["topic"] not in self.received
        ]
        self._socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": silent}))
        self._subscribe(silent)

    def _take(self, data: str | bytes) -> None:
        if isinstance(data, str):
            operation = json.loads(data)
            if operation["op"] == "advertise":
                new = {channel["id"]: channel for channel in operation["channels"]}
                self.channels |= new
                self._subscribe(list(new))
        elif data[0] == 1:
            subscription, log_ns = struct.unpack_from("<IQ", data, 1)
            topic = self.channels[subscription]["topic"]
            self.received.setdefault(topic, []).append((log_ns, data[13:]))
        elif data[0] == 2:
            self.times_ns.append(struct.unpack_from("<Q", data, 1)[0])


def url_of(process: Any) -> str:
    line = process.stdout.readline()
    assert "ws://localhost:" in line, line
    return line.split()[-1]


def test_a_viewer_gets_fixes_and_the_track_live(endpoint: str, tmp_path: Path) -> None:
    write_short_drive(tmp_path / "drive", 1)
    release = tmp_path / "drive" / "map"
    options = ("--vehicle", "car", "--connect", endpoint, "--port", "0", "--map", release)
    gnss, judge = bus_of(endpoint, "gnss"), bus_of(endpoint, "integrity")
    with camber_started("foxglove", *options) as process, Viewer(url_of(process)) as viewer:
        sent = []
        for n in range(60):
            now_ns = CLOCK.now_ns()
            place = {"latitude_rad": 0.6, "longitude_rad": 2.3 + n * 1e-6, "height_m": 50.0}
            fix = Fix(
                time_ns=now_ns, fix_id=n, origin="receiver", quality="fixed", covariance_enu_m2=None, **place
            )
            gnss.publish("fix", fix)
            judge.publish(
                "position", Position(time_ns=now_ns, source="rtk", usable=True, alert_limit_m=1.5, **place)
            )
            sent.append(fix)
            viewer.listen(0.05)
        viewer.listen(1.0)
        with Viewer(viewer.url) as late:
            late.listen(1.0)
        process.terminate()
        assert process.wait(20.0) == 0
    gnss.close()
    judge.close()
    fixes = viewer.received["/gnss/fix/location"]
    assert len(fixes) > 50, "those before it had subscribed are not repeated"
    expected = {unix_ns_from_gps_ns(fix.time_ns): fix for fix in sent}
    for log_ns, data in fixes:
        location = decode("LocationFix", data)
        assert location["timestamp"]["seconds"] * 10**9 + location["timestamp"].get("nanos", 0) == log_ns
        assert location["longitude"] == pytest.approx(
            expected[log_ns].longitude_rad * 180.0 / 3.141592653589793
        )
    assert abs(fixes[-1][0] - time.time_ns()) < 60 * 10**9, "the date is today's"
    (_, track) = viewer.received["/integrity/position/track"][-1]
    assert json.loads(decode("GeoJSON", track)["geojson"])["type"] == "FeatureCollection"
    assert [json.loads(data)["fix_id"] for _, data in viewer.received["/gnss/fix"]][-1] == 59
    assert viewer.times_ns == sorted(viewer.times_ns)
    assert viewer.times_ns[-1] >= fixes[-1][0]
    assert late.received["/integrity/position/track"], "sent again to one that comes later"
    schemas = {channel["topic"]: channel["schemaName"] for channel in viewer.channels.values()}
    assert schemas["/gnss/fix/location"] == "foxglove.LocationFix"
    assert schemas["/gnss/fix"] == "camber.Fix.v1"
    (_, roads) = viewer.received["/map/roads"][0]
    assert json.loads(decode("GeoJSON", roads)["geojson"])["features"]


@pytest.mark.parametrize(("options", "is_reached"), [((), False), (("--published-on-loopback",), True)])
def test_another_address_reaches_it_only_in_a_container(
    endpoint: str, options: tuple[str, ...], is_reached: bool
) -> None:
    with camber_started("foxglove", "--connect", endpoint, "--port", "0", *options) as process:
        port = int(url_of(process).rpartition(":")[2])
        with socket.socket() as caller:
            assert (caller.connect_ex(("127.0.0.2", port)) == 0) is is_reached


def test_a_port_in_use_and_a_map_that_is_none_are_one_line(endpoint: str, tmp_path: Path) -> None:
    with camber_started("foxglove", "--connect", endpoint, "--port", "0") as process:
        port = url_of(process).rpartition(":")[2]
        done = camber("foxglove", "--connect", endpoint, "--port", port)
        assert done.returncode == 2
        assert done.stderr.startswith("camber foxglove: ")
        assert len(done.stderr.splitlines()) == 1
    done = camber("foxglove", "--map", tmp_path / "nosuch")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1


def test_a_peer_that_floods_or_sends_nonsense_ends_nothing(endpoint: str) -> None:
    gnss = bus_of(endpoint, "gnss")
    options = ("--vehicle", "car", "--connect", endpoint, "--port", "0")
    with camber_started("foxglove", *options) as process, Viewer(url_of(process)) as viewer:
        for n in range(200):  # until its subscription is known: before that a flood reaches nobody
            _publish_fix(gnss, n)
            viewer.listen(0.1)
            if viewer.received.get("/gnss/fix"):
                break
        for n in range(3000):
            gnss._session.put("camber/v1/car/gnss/fix", bytes([n % 256]) * (n % 50))
        before = len(viewer.received["/gnss/fix"])
        for n in range(200, 220):
            _publish_fix(gnss, n)
            viewer.listen(0.1)
        process.terminate()
        output, _ = process.communicate(timeout=20.0)
    gnss.close()
    assert process.returncode == 0, output
    assert "not shown" in output
    assert len(viewer.received["/gnss/fix"]) > before


def _publish_fix(gnss: Bus, number: int) -> None:
    place = {"latitude_rad": 0.6, "longitude_rad": 2.3, "height_m": 50.0}
    more = {"time_ns": CLOCK.now_ns(), "fix_id": number, "covariance_enu_m2": None, **place}
    gnss.publish("fix", Fix(origin="receiver", quality="fixed", **more))
