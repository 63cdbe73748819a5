"""The process of the sensors as a whole: who is silent is named, and a fault in one input is none in the other."""

import math
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import pytest

import camber.sensors.service
from camber.formats.lidar_can.candump import CanFrame, candump_text
from camber.formats.lidar_can.dbc import read_dbc
from camber.formats.lidar_can.pcap import Datagram, pcap_frames, pcap_header
from camber.geodesy.gps_time import UNIX_OF_GPS_EPOCH_NS, unix_ns_from_gps_ns
from camber.runtime.bus import Bus
from camber.schemas.base import Message
from camber.schemas.motion import Imu
from camber.sensors.service import SensorsService
from camber.sensors.settings import SensorsSettings
from camber.simulator.output.can_frames import DBC
from camber.simulator.output.lidar_packets import ouster_metadata
from support.fake_bus import FakeBus

S = 1_000_000_000
START_NS = 1_400_000_000 * S
UNIX_NS = unix_ns_from_gps_ns(START_NS)
MESSAGES = read_dbc(DBC, "can.dbc")
SIGNALS = {
    "yaw_rate": {"signal": "Dynamics.YawRate", "unit": "deg/s"},
    "stroke_height": {"signal": "Suspension.Height", "unit": "mm"},
}
LIDAR = {"source": "udp:127.0.0.1:1", "model": "HDL-32E", "stamps": "utc_hour"}


class PublishingBus(FakeBus):
    def __init__(self) -> None:
        super().__init__(START_NS)
        self.given: list[tuple[str, Message]] = []

    def publish(self, name: str, message: Message) -> None:
        self.given.append((name, message))


class Time:
    """A machine whose two clocks go on together, until somebody sets the one."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.passed_s = 0.0
        self.bus = PublishingBus()
        self.services: list[SensorsService] = []
        monkeypatch.setattr(
            camber.sensors.service, "time", SimpleNamespace(monotonic=lambda: self.passed_s), raising=False
        )

    def go(self, service: SensorsService, seconds: float, step_s: float = 0.1) -> None:
        for _ in range(round(seconds / step_s)):
            self.passed_s += step_s
            self.bus.time_ns += round(step_s * S)
            service.advance(self.bus.time_ns)


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> Iterator[Time]:
    result = Time(monkeypatch)
    yield result
    for each in result.services:
        each.close()


def frame(name: str, at_s: float) -> CanFrame:
    message = MESSAGES[name]
    return CanFrame(
        time_ns=UNIX_NS + round(at_s * S),
        bus="can0",
        identifier=message.identifier,
        extended=message.extended,
        data=bytes(message.length_bytes),
    )


def service(
    time: Time, folder: Path, frames: list[CanFrame], signals: Any = SIGNALS, **more: Any
) -> SensorsService:
    (folder / "can.dbc").write_text(DBC)
    (folder / "can.log").write_text(candump_text(frames))
    can = {"source": f"candump:{folder / 'can.log'}", "dbc": str(folder / "can.dbc"), **signals}
    time.services.append(SensorsService(SensorsSettings(can=cast(Any, can), **more), cast(Bus, time.bus)))
    return time.services[-1]


def texts(time: Time, wanted: str) -> list[str]:
    return [text for code, text in time.bus.issues if code == wanted]


def test_a_bus_that_is_dead_stays_so_when_the_clock_is_set_back(time: Time, tmp_path: Path) -> None:
    one = service(time, tmp_path, [frame(name, 0.0) for name in ("Dynamics", "Suspension")])
    time.go(one, 1.0)
    assert one.healthy()
    time.go(one, 2.0)
    assert texts(time, "sensor_silent") == ["can: no stroke_height for 2 s", "can: no yaw_rate for 2 s"]
    time.bus.time_ns -= 3600 * S
    time.go(one, 1.0)
    assert not one.healthy()


def test_strokes_are_no_motion(time: Time, tmp_path: Path) -> None:
    one = service(
        time, tmp_path, [frame("Dynamics", 0.0), *(frame("Suspension", k / 10) for k in range(100))]
    )
    time.go(one, 5.0)
    assert {name for name, _ in time.bus.given[-10:]} == {"suspension"}
    assert texts(time, "sensor_silent") == ["can: no yaw_rate for 2 s"]
    assert not one.healthy()


def test_a_quantity_that_is_never_known_is_named_though_others_are(time: Time, tmp_path: Path) -> None:
    """The message of the wheels does not come; that of the yaw rate makes a motion each time."""
    signals = {**SIGNALS, "wheel_speed": {"signal": "Wheels.Speed", "unit": "km/h"}}
    frames = [frame(name, k / 10) for k in range(40) for name in ("Dynamics", "Suspension")]
    one = service(time, tmp_path, frames, signals)
    time.go(one, 3.5)
    assert texts(time, "sensor_silent") == ["can: no wheel_speed for 2 s"]
    assert not one.healthy()


def test_of_a_log_of_two_buses_the_first_is_read_and_the_other_named(time: Time, tmp_path: Path) -> None:
    other = [
        replace(frame("Dynamics", k / 10 + 0.05), bus="can1", data=bytes([0, 1, 0, 0, 0, 0, 0, 0]))
        for k in range(20)
    ]
    one = service(time, tmp_path, [each for k in range(20) for each in (frame("Dynamics", k / 10), other[k])])
    time.go(one, 2.5)
    assert {message.yaw_rate_rad_s for _, message in time.bus.given} == {0.0}
    assert ("can_recording", "frames of can1, not only of can0: set bus") in time.bus.issues
    assert time.bus.counters["can.frames.of_other_buses"] == 20


def test_a_fault_in_the_lidar_is_none_in_the_motion(time: Time, tmp_path: Path) -> None:
    one = service(time, tmp_path, [frame("Dynamics", k / 10) for k in range(50)], lidar=cast(Any, LIDAR))

    one._packets = Mock(take=Mock(side_effect=RuntimeError("lidar")))
    for _ in range(30):
        with pytest.raises(RuntimeError):
            time.go(one, 0.1)
    assert Counter(name for name, _ in time.bus.given) == {"motion": 31}
    assert texts(time, "sensor_silent") == ["can: no stroke_height for 2 s", "lidar: no sweep for 2 s"]


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_playing_goes_on_where_the_recordings_clock_was_set(
    time: Time, tmp_path: Path, step_s: float
) -> None:
    times_s = [k / 10 + step_s * (k >= 20) for k in range(60)]
    one = service(time, tmp_path, [frame("Dynamics", at_s) for at_s in times_s], recordings="now")
    time.go(one, 6.5)
    motion = [message.time_ns for _, message in time.bus.given]
    assert len(motion) == 60
    assert motion == pytest.approx([START_NS + k * S // 10 for k in range(60)], abs=0.3 * S)
    assert texts(time, "recording_stepped") == [f"the recording goes on {step_s:+.3f} s from where it was"]


def imu_packet(at_s: float) -> bytes:
    stamp_ns = START_NS + UNIX_OF_GPS_EPOCH_NS + round((19 + at_s) * S)
    return struct.pack("<3Q6f", 0, stamp_ns, stamp_ns, 0.0, 0.0, 1.0, 0.0, 0.0, 90.0)


def ouster(folder: Path, source: str) -> Any:
    (folder / "os.json").write_text(ouster_metadata())
    metadata = {"model": "ouster", "metadata": folder / "os.json", "stamps": "tai"}
    return cast(Any, {"source": source, "imu_port": 7503, **metadata})


def test_inertial_samples_of_a_recording_are_at_their_port_among_those_of_the_lidar(
    time: Time, tmp_path: Path
) -> None:
    datagrams = [
        Datagram(time_ns=UNIX_NS + k * S // 100, source="10.0.0.2", port=port, payload=imu_packet(k / 100))
        for k in range(200)
        for port in (7503, 7504)
    ]
    path = tmp_path / "lidar.pcap"
    path.write_bytes(pcap_header() + b"".join(pcap_frames(each, "10.0.0.1", 1) for each in datagrams))
    settings = SensorsSettings(lidar=ouster(tmp_path, f"pcap:{path}"))
    time.services.append(one := SensorsService(settings, cast(Bus, time.bus)))
    time.go(one, 1.5)
    assert {name for name, _ in time.bus.given} == {"imu"}
    assert [message.time_ns for _, message in time.bus.given] == [START_NS + k * S // 100 for k in range(151)]
    assert time.bus.counters["imu.packets.read"] == 151
    assert time.bus.counters["lidar.packets.of_others"] == 151
    time.go(one, 3.0)
    assert texts(time, "sensor_silent") == ["lidar: no sweep for 2 s", "lidar: no imu for 2 s"]


def test_inertial_samples_come_to_another_port(time: Time, tmp_path: Path) -> None:
    settings = SensorsSettings(lidar=ouster(tmp_path, "udp:127.0.0.1:1"))
    time.services.append(one := SensorsService(settings, cast(Bus, time.bus)))
    packets = [Datagram(time_ns=UNIX_NS, source="10.0.0.2", port=7503, payload=imu_packet(0.0))]
    one._imu_packets = Mock(take=Mock(return_value=packets), issues=[("lidar_port", "in use")], counts={})
    time.go(one, 0.1)
    (sample,) = (message for _, message in time.bus.given)
    assert isinstance(sample, Imu)
    assert sample.angular_rate_rad_s[2] == pytest.approx(math.pi / 2)
    assert texts(time, "lidar_port")[-1] == "IMU: in use"


def test_where_one_recording_alone_has_a_gap_the_other_stays_with_it(time: Time, tmp_path: Path) -> None:
    datagrams = [
        Datagram(time_ns=UNIX_NS + s * S, source="10.0.0.2", port=2368, payload=b"packet") for s in (0, 1, 30)
    ]
    path = tmp_path / "lidar.pcap"
    path.write_bytes(pcap_header() + b"".join(pcap_frames(each, "10.0.0.1", 1) for each in datagrams))
    lidar = cast(Any, {**LIDAR, "source": f"pcap:{path}"})
    one = service(time, tmp_path, [frame("Dynamics", k / 10) for k in range(400)], lidar=lidar)
    time.go(one, 20.0)
    assert time.bus.counters["lidar.packets.read"] == 2
    assert len(time.bus.given) == pytest.approx(200, abs=2)
    time.go(one, 11.0)
    assert time.bus.counters["lidar.packets.read"] == 3
    assert texts(time, "recording_stepped") == []
