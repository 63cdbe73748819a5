"""Metadata of an Ouster sensor in JSON: its beams, its frame, the format of its packets.

Source: "Sensor metadata" of Ouster's firmware manual: the answer of `/api/v1/sensor/metadata` (firmware 2.3 and
later) and the flat file of earlier ones. Angles are in degrees there, lengths in millimetres, matrices row by row.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.lidar_can.firings import Float64

COLUMNS_OF_PACKET = 16  # "Lidar data packet format"; other counts are refused
PROFILES = ("LEGACY", "RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL", "RNG15_RFL8_NIR8")
LEGACY_IMU = "LEGACY"
FREE_RUNNING = "TIME_FROM_INTERNAL_OSC"
_MOST_BYTES = 1 << 20  # chosen: hundred times a sensor's metadata
_LAYOUT = ("lidar_data_format", "data_format")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OusterMetadata:
    """Beams (b,) from top to bottom; `beam_to_lidar`, `lidar_to_sensor` and `imu_to_sensor` (4, 4) with metres.

    `serial` and `timestamp_mode` are None where the file does not contain them.
    """

    product: str
    serial: int | None
    profile: str
    columns: int
    turns_hz: int
    elevation_rad: Float64
    azimuth_rad: Float64
    beam_to_lidar: Float64
    lidar_to_sensor: Float64
    imu_to_sensor: Float64
    imu_profile: str
    timestamp_mode: str | None


def read_ouster_metadata(text: str, source_name: str) -> OusterMetadata:
    """Parse metadata. Raises FormatError with the missing or invalid field."""
    if len(text) > _MOST_BYTES:
        raise FormatError(source_name, "size", f"{_MOST_BYTES} characters at most", actual=str(len(text)))
    try:
        whole = json.loads(text)
    except (ValueError, RecursionError):
        raise FormatError(source_name, "content", "JSON, the sensor's metadata") from None
    if not isinstance(whole, dict):
        raise FormatError(source_name, "content", "a JSON object, the sensor's metadata")
    fields = _Fields(whole, source_name)
    mode, columns, turns_hz = fields.mode()
    fields.require(("columns_per_frame", *_LAYOUT), (None, columns), f"{columns}, as of lidar_mode {mode}")
    profile = fields.get("udp_profile_lidar", *_LAYOUT, "config_params") or "LEGACY"
    if profile not in PROFILES:
        raise fields.error("udp_profile_lidar", f"one of {', '.join(PROFILES)}", profile)
    fields.require(("header_type", "lidar_data_format"), (None, "STANDARD"), "STANDARD")
    fields.require(("columns_per_packet", *_LAYOUT), (None, COLUMNS_OF_PACKET), str(COLUMNS_OF_PACKET))
    elevation = fields.numbers("beam_altitude_angles", "beam_intrinsics")
    azimuth = fields.numbers("beam_azimuth_angles", "beam_intrinsics")
    if len(elevation) not in (16, 32, 64, 128) or len(azimuth) != len(elevation):
        names = "beam_altitude_angles, beam_azimuth_angles"
        raise FormatError(source_name, names, "16, 32, 64 or 128 angles each")
    serial = fields.get("prod_sn", "sensor_info")
    stamps = fields.get("timestamp_mode", "config_params")
    return OusterMetadata(
        product=str(fields.get("prod_line", "sensor_info") or "Ouster")[:40],
        serial=int(serial) if isinstance(serial, str) and serial.isdecimal() and len(serial) < 16 else None,
        profile=profile,
        columns=columns,
        turns_hz=turns_hz,
        elevation_rad=np.radians(elevation),
        azimuth_rad=np.radians(azimuth),
        beam_to_lidar=fields.beam_to_lidar(),
        lidar_to_sensor=fields.matrix("lidar_to_sensor_transform", "lidar_intrinsics"),
        imu_to_sensor=fields.imu_to_sensor(),
        imu_profile=str(fields.get("udp_profile_imu", *_LAYOUT, "config_params") or LEGACY_IMU)[:40],
        timestamp_mode=stamps if isinstance(stamps, str) else None,
    )


class _Fields:
    """A field is in one of the named tables, or at the top level of an earlier file."""

    def __init__(self, whole: dict[str, Any], source_name: str) -> None:
        self._whole, self._source_name = whole, source_name

    def error(self, name: str, expected: str, value: Any) -> FormatError:
        actual = "missing" if value is None else str(value)
        return FormatError(self._source_name, name, expected, actual=actual)

    def get(self, name: str, *tables: str) -> Any:
        for table in (*(self._whole.get(table) for table in tables), self._whole):
            if isinstance(table, dict) and name in table:
                return table[name]
        return None

    def require(self, field: tuple[str, ...], allowed: tuple[Any, ...], expected: str) -> None:
        """Raise FormatError unless a field, name and tables, has one of the allowed values."""
        value = self.get(*field)
        if value not in allowed:
            raise self.error(field[0], expected, value)

    def mode(self) -> tuple[str, int, int]:
        """Return `lidar_mode`, its columns and its rotations per second."""
        mode = self.get("lidar_mode", "config_params")
        if not isinstance(mode, str):
            raise self.error("lidar_mode", "a text", mode)
        columns, _, turns_hz = mode.partition("x")
        if columns not in ("512", "1024", "2048", "4096") or turns_hz not in ("5", "10", "20"):
            raise self.error("lidar_mode", "COLUMNSxHZ, such as 1024x10", mode)
        return mode, int(columns), int(turns_hz)

    def numbers(self, name: str, *tables: str) -> Float64:
        value = self.get(name, *tables)
        try:
            numbers = np.array(value, np.float64)
        except (TypeError, ValueError, OverflowError):
            numbers = np.array(np.nan)
        if numbers.ndim != 1 or not np.isfinite(numbers).all() or (np.abs(numbers) > 1e6).any():
            raise self.error(name, "a list of numbers", value)
        return numbers

    def matrix(self, name: str, *tables: str) -> Float64:
        numbers = self.numbers(name, *tables)
        if len(numbers) != 16:
            raise self.error(name, "16 numbers, row by row", f"{len(numbers)} numbers")
        matrix: Float64 = numbers.reshape(4, 4).copy()
        matrix[:3, 3] /= 1000.0
        return matrix

    def imu_to_sensor(self) -> Float64:
        """Of a file without it: that the axes are the sensor's, as they are in all sensors so far."""
        name = ("imu_to_sensor_transform", "imu_intrinsics")
        return np.eye(4) if self.get(*name) is None else self.matrix(*name)

    def beam_to_lidar(self) -> Float64:
        if self.get("beam_to_lidar_transform", "beam_intrinsics") is not None:
            return self.matrix("beam_to_lidar_transform", "beam_intrinsics")
        name = "lidar_origin_to_beam_origin_mm"
        offset_mm = self.get(name, "beam_intrinsics")
        if not isinstance(offset_mm, int | float) or not abs(offset_mm) <= 1000.0:
            raise self.error(name, "a number", offset_mm)
        matrix = np.eye(4)
        matrix[0, 3] = offset_mm / 1000.0
        return matrix
