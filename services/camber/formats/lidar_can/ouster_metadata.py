"""What an Ouster sensor says of itself in JSON: its beams, its frame, the format of its packets.

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

COLUMNS_OF_PACKET = 16
PROFILES = ("LEGACY", "RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL", "RNG15_RFL8_NIR8")
FREE_RUNNING = "TIME_FROM_INTERNAL_OSC"
_MOST_BYTES = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class OusterMetadata:
    """Beams (b,) from top to bottom; `beam_to_lidar` and `lidar_to_sensor` (4, 4) with metres.

    `serial` and `timestamp_mode` are None where the file does not say.
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
    timestamp_mode: str | None


def read_ouster_metadata(text: str, source_name: str) -> OusterMetadata:
    """Raises FormatError that names what is missing or cannot be."""
    if len(text) > _MOST_BYTES:
        raise FormatError(source_name, "size", f"{_MOST_BYTES} characters at most", actual=str(len(text)))
    try:
        whole = json.loads(text)
    except (ValueError, RecursionError):
        raise FormatError(source_name, "content", "JSON, the sensor's metadata") from None
    if not isinstance(whole, dict):
        raise FormatError(source_name, "content", "a JSON object, the sensor's metadata")
    fields = _Fields(whole, source_name)
    mode = fields.text("lidar_mode", "config_params")
    columns, turns = _mode(mode, source_name)
    said = fields.get("columns_per_frame", "lidar_data_format", "data_format")
    if said is not None and said != columns:
        raise FormatError(
            source_name, "columns_per_frame", f"{columns}, as of lidar_mode {mode}", actual=str(said)
        )
    profile = fields.get("udp_profile_lidar", "lidar_data_format", "data_format", "config_params") or "LEGACY"
    if profile not in PROFILES:
        raise FormatError(
            source_name, "udp_profile_lidar", f"one of {', '.join(PROFILES)}", actual=str(profile)
        )
    header = fields.get("header_type", "lidar_data_format")
    if header not in (None, "STANDARD"):
        raise FormatError(source_name, "header_type", "STANDARD", actual=str(header))
    per_packet = fields.get("columns_per_packet", "lidar_data_format", "data_format")
    if per_packet not in (None, COLUMNS_OF_PACKET):
        raise FormatError(source_name, "columns_per_packet", str(COLUMNS_OF_PACKET), actual=str(per_packet))
    elevation = fields.numbers("beam_altitude_angles", "beam_intrinsics")
    azimuth = fields.numbers("beam_azimuth_angles", "beam_intrinsics")
    if len(elevation) not in (16, 32, 64, 128) or len(azimuth) != len(elevation):
        raise FormatError(
            source_name, "beam_altitude_angles, beam_azimuth_angles", "16, 32, 64 or 128 angles each"
        )
    serial = fields.get("prod_sn", "sensor_info")
    stamps = fields.get("timestamp_mode", "config_params")
    return OusterMetadata(
        product=str(fields.get("prod_line", "sensor_info") or "Ouster")[:40],
        serial=int(serial) if isinstance(serial, str) and serial.isdecimal() and len(serial) < 16 else None,
        profile=profile,
        columns=columns,
        turns_hz=turns,
        elevation_rad=np.radians(elevation),
        azimuth_rad=np.radians(azimuth),
        beam_to_lidar=_beam_to_lidar(fields),
        lidar_to_sensor=fields.matrix("lidar_to_sensor_transform", "lidar_intrinsics"),
        timestamp_mode=stamps if isinstance(stamps, str) else None,
    )


class _Fields:
    """A field stands in one of the named tables, or at the top of an earlier file."""

    def __init__(self, whole: dict[str, Any], source_name: str) -> None:
        self._whole, self.source_name = whole, source_name

    def get(self, name: str, *tables: str) -> Any:
        for table in (*(self._whole.get(table) for table in tables), self._whole):
            if isinstance(table, dict) and name in table:
                return table[name]
        return None

    def text(self, name: str, *tables: str) -> str:
        value = self.get(name, *tables)
        if not isinstance(value, str):
            raise FormatError(self.source_name, name, "a text", actual=_shown(value))
        return value

    def numbers(self, name: str, *tables: str) -> Float64:
        value = self.get(name, *tables)
        try:
            found = np.array(value, np.float64)
        except (TypeError, ValueError, OverflowError):
            found = np.array(np.nan)
        if found.ndim != 1 or not np.isfinite(found).all() or (np.abs(found) > 1e6).any():
            raise FormatError(self.source_name, name, "a list of numbers", actual=_shown(value))
        return found

    def matrix(self, name: str, *tables: str) -> Float64:
        numbers = self.numbers(name, *tables)
        if len(numbers) != 16:
            raise FormatError(
                self.source_name, name, "16 numbers, row by row", actual=f"{len(numbers)} numbers"
            )
        found: Float64 = numbers.reshape(4, 4).copy()
        found[:3, 3] /= 1000.0
        return found


def _shown(value: Any) -> str:
    return "missing" if value is None else str(value)


def _mode(mode: str, source_name: str) -> tuple[int, int]:
    columns, _, turns = mode.partition("x")
    if columns not in ("512", "1024", "2048", "4096") or turns not in ("5", "10", "20"):
        raise FormatError(source_name, "lidar_mode", "COLUMNSxHZ, such as 1024x10", actual=mode)
    return int(columns), int(turns)


def _beam_to_lidar(fields: _Fields) -> Float64:
    if fields.get("beam_to_lidar_transform", "beam_intrinsics") is not None:
        return fields.matrix("beam_to_lidar_transform", "beam_intrinsics")
    found = np.eye(4)
    off_mm = fields.get("lidar_origin_to_beam_origin_mm", "beam_intrinsics")
    if not isinstance(off_mm, int | float) or not abs(off_mm) <= 1000.0:
        raise FormatError(
            fields.source_name, "lidar_origin_to_beam_origin_mm", "a number", actual=_shown(off_mm)
        )
    found[0, 3] = off_mm / 1000.0
    return found
