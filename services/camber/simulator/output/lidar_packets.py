"""Sweeps as the packets of sensors that can be bought: a Velodyne HDL-32E, an Ouster OS1-64.

The simulated sensor has the maker's beams, order and pace of firing, and the same resolution of distances, so that what
a decoder makes of the packets is the sweep but for what the format rounds.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from camber.formats.lidar_can import ouster, velodyne
from camber.formats.lidar_can.ouster_metadata import COLUMNS_OF_PACKET
from camber.formats.lidar_can.pcap import Datagram, pcap_frames, pcap_header
from camber.geodesy.gps_time import NS_PER_SECOND, UNIX_OF_GPS_EPOCH_NS, unix_ns_from_gps_ns
from camber.schemas.lidar import Sweep
from camber.simulator.vehicle.beam_pattern import BeamPattern

SENSOR_ADDRESS, MACHINE_ADDRESS = "192.168.1.201", "192.168.1.100"
VELODYNE_PORT, OUSTER_PORT = 2368, 7502
_TRANSIT_NS = 50_000  # chosen: from a packet's last measurement to the recording machine
_MODEL = velodyne.MODELS["HDL-32E"]
_FIRING_NS = 46_080  # HDL-32E user's manual: 32 beams and a pause
_COLUMNS = 2170  # firings of a turn of 0.1 s
_BEAMS = 32  # of an HDL-32E

HDL_32E = BeamPattern(
    name="hdl-32e",
    elevation_deg=_MODEL.elevation_deg,
    # It goes on turning, clockwise, while its beams fire.
    azimuth_deg=tuple(-360.0 / _COLUMNS * (after / _FIRING_NS) for after in _MODEL.beam_after_ns.tolist()),
    columns=_COLUMNS,
    turn_ns=_COLUMNS * _FIRING_NS,
    firing_share=_BEAMS * _MODEL.beam_ns / _FIRING_NS,
    most_range_m=100.0,
    up_m=tuple(up_mm / 1000.0 for up_mm in _MODEL.up_mm),
)
OS1_64 = BeamPattern(
    name="os1-64",
    elevation_deg=tuple(22.5 - 45.0 / 63.0 * k for k in range(64)),
    azimuth_deg=tuple((-4.2, -1.4, 1.4, 4.2)[k % 4] for k in range(64)),
    columns=1024,
    firing_share=0.0,
    range_step_m=0.001,
)
PATTERNS = {"velodyne": HDL_32E, "ouster": OS1_64}
SESSION = 7  # chosen
PROFILE = "RNG19_RFL8_SIG16_NIR16"
SERIAL = 122_113_000_001  # chosen: as long as real ones
_TAI_AHEAD_NS = 19 * NS_PER_SECOND  # of GPS time, a constant


def pcap_of(sweeps: Iterable[Sweep], kind: str) -> Iterator[bytes]:
    """A recording of the network, piece by piece: the packets of sweeps that follow one another without a gap."""
    yield pcap_header()
    is_velodyne = kind == "velodyne"
    port, packets_of = (VELODYNE_PORT, velodyne_packets) if is_velodyne else (OUSTER_PORT, ouster_packets)
    for number, (last_ns, payload) in enumerate(packets_of(sweeps)):
        time_ns = unix_ns_from_gps_ns(last_ns + _TRANSIT_NS)
        yield pcap_frames(
            Datagram(time_ns=time_ns, source=SENSOR_ADDRESS, port=port, payload=payload),
            MACHINE_ADDRESS,
            number,
        )


def velodyne_packets(sweeps: Iterable[Sweep]) -> Iterator[tuple[int, bytes]]:
    """GPS time of the last measurement, and the packet. Its stamp is in whole microseconds, its azimuths in 0.01°."""
    ray_ns = HDL_32E.offsets_ns()
    firings: list[tuple[int, int, Any]] = []
    directions = HDL_32E.directions()
    for sweep in sweeps:
        ray = np.searchsorted(ray_ns, sweep.offset_ns)
        beams = np.zeros(HDL_32E.rays, velodyne.BLOCK["beams"].base)
        points = sweep.points_m.astype(np.float64)
        points[:, 2] -= HDL_32E.rises_m()[ray]
        beams["distance"][ray] = np.rint((points * directions[ray]).sum(axis=1) / _MODEL.step_m)
        beams["brightness"][ray] = sweep.intensity
        begin_ns = sweep.time_ns - HDL_32E.turn_ns
        azimuth = np.rint((np.arange(_COLUMNS) + 0.5) * (36_000.0 / _COLUMNS) + 18_000.0).astype(int) % 36_000
        rows = zip(azimuth.tolist(), beams.reshape(_COLUMNS, _BEAMS), strict=True)
        firings += [(begin_ns + k * _FIRING_NS, around, row) for k, (around, row) in enumerate(rows)]
        while len(firings) >= 12:
            yield _velodyne_packet(firings[:12])
            del firings[:12]
    if firings:
        time_ns, around, row = firings[-1]
        for k in range(1, 13 - len(firings)):  # the turn goes on, and sees nothing
            beyond = (around + round(k * 36_000.0 / _COLUMNS)) % 36_000
            firings.append((time_ns + k * _FIRING_NS, beyond, np.zeros_like(row)))
        yield _velodyne_packet(firings)


def _velodyne_packet(firings: list[tuple[int, int, Any]]) -> tuple[int, bytes]:
    packet = np.zeros((), velodyne.PACKET)
    packet["blocks"]["flag"] = velodyne.BLOCK_FLAG
    packet["blocks"]["azimuth"] = [around for _, around, _ in firings]
    packet["blocks"]["beams"] = [row for _, _, row in firings]
    packet["stamp_us"] = unix_ns_from_gps_ns(firings[0][0]) % velodyne.HOUR_NS // 1000
    packet["mode"], packet["model"] = velodyne.STRONGEST, _MODEL.code
    return firings[-1][0] + _FIRING_NS, packet.tobytes()


def ouster_packets(sweeps: Iterable[Sweep]) -> Iterator[tuple[int, bytes]]:
    """GPS time of the last measurement, and the packet. Its clock counts TAI, as one that PTP has set."""
    ray_ns = OS1_64.offsets_ns().reshape(OS1_64.columns, -1)[:, 0]
    elevation = np.radians(OS1_64.elevation_deg)
    packet_type = ouster.packet_type(PROFILE, len(elevation))
    pixel_type = packet_type["columns"].base["pixels"].base
    for frame, sweep in enumerate(sweeps):
        distance = np.linalg.norm(sweep.points_m.astype(np.float64), axis=1)
        up = np.arcsin(sweep.points_m[:, 2] / distance)
        beam = np.abs(up[:, None] - elevation).argmin(axis=1)
        pixels = np.zeros((OS1_64.columns, len(elevation)), pixel_type)
        column = np.searchsorted(ray_ns, sweep.offset_ns)
        pixels["range"][column, beam] = np.rint(distance * 1000.0)
        pixels["reflectivity"][column, beam] = sweep.intensity
        for first in range(0, OS1_64.columns, COLUMNS_OF_PACKET):
            rows = slice(first, first + COLUMNS_OF_PACKET)
            packet = np.zeros((), packet_type)
            packet["type"], packet["frame"] = ouster.LIDAR_PACKET, frame & 0xFFFF
            packet["session"] = list(SESSION.to_bytes(3, "little"))
            packet["serial"] = list(SERIAL.to_bytes(5, "little"))
            time_ns = sweep.time_ns + ray_ns[rows]
            columns = packet["columns"]
            columns["stamp_ns"] = time_ns + UNIX_OF_GPS_EPOCH_NS + _TAI_AHEAD_NS
            columns["place"] = np.arange(first, first + COLUMNS_OF_PACKET)
            columns["status"] = 1
            columns["pixels"] = pixels[rows]
            yield int(time_ns[-1]), packet.tobytes()


def ouster_metadata() -> str:
    """The simulated OS1-64's description; its beams begin in its middle."""
    identity = np.eye(4)
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])
    half_column_deg = 180.0 / OS1_64.columns
    metadata = {
        "sensor_info": {"prod_line": "OS-1-64", "prod_sn": str(SERIAL), "initialization_id": SESSION},
        "config_params": {"lidar_mode": "1024x10", "timestamp_mode": "TIME_FROM_PTP_1588"},
        "lidar_data_format": {
            "columns_per_frame": OS1_64.columns,
            "columns_per_packet": COLUMNS_OF_PACKET,
            "column_window": [0, OS1_64.columns - 1],
            "pixels_per_column": len(OS1_64.elevation_deg),
            "udp_profile_lidar": PROFILE,
        },
        "beam_intrinsics": {
            "beam_altitude_angles": list(OS1_64.elevation_deg),
            "beam_azimuth_angles": [half_column_deg - azimuth for azimuth in OS1_64.azimuth_deg],
            "beam_to_lidar_transform": identity.reshape(-1).tolist(),
            "lidar_origin_to_beam_origin_mm": 0.0,
        },
        "calibration_status": {},
        "imu_intrinsics": {"imu_to_sensor_transform": identity.reshape(-1).tolist()},
        "lidar_intrinsics": {"lidar_to_sensor_transform": turned.reshape(-1).tolist()},
    }
    return json.dumps(metadata, indent=1) + "\n"
