"""IMU packets of an Ouster become samples in SI units and GPS time; what cannot be used is one line."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.formats.errors import FormatError
from camber.formats.lidar_can.ouster_imu import OusterImuSample, read_imu_packet
from camber.formats.lidar_can.ouster_metadata import read_ouster_metadata
from camber.geodesy.gps_time import NS_PER_SECOND, UNIX_OF_GPS_EPOCH_NS
from camber.schemas.motion import Imu
from camber.sensors.imu_reader import ImuReader
from camber.sensors.sensor_clock import SensorClock
from camber.simulator.output.lidar_packets import ouster_metadata

START_NS = 1_400_000_000 * NS_PER_SECOND
TAI_NS = UNIX_OF_GPS_EPOCH_NS + 19 * NS_PER_SECOND  # of a TAI stamp less GPS time
G_M_S2 = 9.80665


def packet(
    time_ns: int, *, force_g: Sequence[float] = (0.0, 0.0, 1.0), rate_deg_s: Sequence[float] = (0.0, 0.0, 0.0)
) -> bytes:
    """As in the table of the manual: byte 0 diagnosis, 8 accelerometer, 16 gyro, 24 accelerations, 36 rates."""
    data = bytearray(48)
    struct.pack_into("<Q", data, 0, 12_345)
    struct.pack_into("<Q", data, 8, time_ns + TAI_NS - 1_000)
    struct.pack_into("<Q", data, 16, time_ns + TAI_NS)
    struct.pack_into("<3f", data, 24, *force_g)
    struct.pack_into("<3f", data, 36, *rate_deg_s)
    return bytes(data)


def reader(turn: Any = None) -> ImuReader:
    return ImuReader(np.eye(3) if turn is None else turn, SensorClock("tai", 0, NS_PER_SECOND // 10))


def test_a_packet_is_a_sample_in_si_units_at_the_time_of_its_gyro() -> None:
    payload = packet(START_NS, force_g=(0.5, -0.25, 1.0), rate_deg_s=(90.0, 0.0, -45.0))
    (sample,) = reader().take([payload], [START_NS + 1_000_000], ["10.0.0.2"])
    assert sample.time_ns == START_NS
    assert sample.specific_force_m_s2 == pytest.approx((0.5 * G_M_S2, -0.25 * G_M_S2, G_M_S2))
    assert sample.angular_rate_rad_s == pytest.approx((0.5 * math.pi, 0.0, -0.25 * math.pi))


def test_samples_are_in_the_axes_of_the_sensor() -> None:
    """A unit that looks to the left: its x is the sensor's y."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    payload = packet(START_NS, force_g=(0.5, 0.0, 1.0), rate_deg_s=(90.0, 0.0, 0.0))
    (sample,) = reader(turn).take([payload], [START_NS], [""])
    assert sample.specific_force_m_s2 == pytest.approx((0.0, 0.5 * G_M_S2, G_M_S2))
    assert sample.angular_rate_rad_s == pytest.approx((0.0, 0.5 * math.pi, 0.0))


@pytest.mark.parametrize(
    ("payload", "issue"),
    [
        (packet(START_NS)[:-1], ("lidar_packets", "IMU: a packet of 47 bytes, expected 48")),
        (b"", ("lidar_packets", "IMU: a packet of 0 bytes, expected 48")),
        (
            packet(START_NS, rate_deg_s=(math.nan, 0.0, 0.0)),
            ("lidar_packets", "IMU: a packet with numbers that are not finite"),
        ),
        (
            packet(START_NS, force_g=(0.0, 0.0, 50.0)),
            ("lidar_packets", "IMU: specific_force_m_s2.2: Input should be less than or equal to 400"),
        ),
        (
            packet(START_NS - 37 * NS_PER_SECOND),
            (
                "lidar_clock",
                "IMU: stamps read as tai are -37.000 s from this machine's clock; 37 s: the stamps",
            ),
        ),
    ],
)
def test_a_packet_that_cannot_be_used_is_one_issue_and_costs_itself(
    payload: bytes, issue: tuple[str, str]
) -> None:
    one = reader()
    good = [packet(START_NS), packet(START_NS + 10_000_000)]
    arrivals = [START_NS, START_NS, START_NS + 10_000_000]
    samples = one.take([good[0], payload, good[1]], arrivals, ["a", "a", "a"])
    ((code, text),) = one.issues
    assert code == issue[0]
    assert text.startswith(issue[1])
    assert one.counts["packets.read"] == 3
    # After a clock that seems to have been set, the next packet may be refused, too.
    assert {sample.time_ns for sample in samples} >= {START_NS}
    one.take([], [], [])
    assert one.issues == []


def test_of_two_sensors_one_is_read_and_the_other_named() -> None:
    one = reader()
    samples = one.take([packet(START_NS + k) for k in range(4)], [START_NS] * 4, ["a", "b", "a", "b"])
    assert [sample.time_ns for sample in samples] == [START_NS, START_NS + 2]
    assert one.issues == [("lidar_packets", "packets from b too, not only of a: set sender")]
    assert one.counts["packets.of_others"] == 2


@given(st.binary(max_size=60) | st.binary(min_size=48, max_size=48))
def test_any_bytes_are_a_sample_or_a_reason(data: bytes) -> None:
    sample = read_imu_packet(data, np.eye(3))
    assert isinstance(sample, OusterImuSample | str)
    one = reader()
    assert all(isinstance(message, Imu) for message in one.take([data], [START_NS], [""]))


def metadata(**intrinsics: Any) -> str:
    whole = json.loads(ouster_metadata())
    whole["imu_intrinsics"] = intrinsics
    return json.dumps(whole)


def test_metadata_give_the_axes_of_the_unit_and_without_them_they_are_the_sensors() -> None:
    turned = [0.0, -1.0, 0.0, 6.253, 1.0, 0.0, 0.0, -11.775, 0.0, 0.0, 1.0, 7.645, 0.0, 0.0, 0.0, 1.0]
    given_axes = read_ouster_metadata(metadata(imu_to_sensor_transform=turned), "os.json").imu_to_sensor
    assert given_axes[:3, 0] == pytest.approx([0.0, 1.0, 0.0])
    assert given_axes[:3, 3] == pytest.approx([0.006253, -0.011775, 0.007645])
    np.testing.assert_array_equal(read_ouster_metadata(metadata(), "os.json").imu_to_sensor, np.eye(4))
    with pytest.raises(FormatError, match="imu_to_sensor_transform"):
        read_ouster_metadata(metadata(imu_to_sensor_transform=[1.0]), "os.json")
