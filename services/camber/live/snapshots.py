"""What the page asks for one time at a time, because it is too much to send all of it: the newest of a kind by time."""

from __future__ import annotations

import json
import math
import threading
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from camber.formats.observations import satellite_name
from camber.schemas.base import Float32, Float64
from camber.schemas.gnss import SATELLITE_USES, SatellitesInView
from camber.schemas.pose import ScanMatchPoints

_LIMIT_BYTES = 32 << 20
"""Of one kind. Chosen: six hours of satellites at 1 Hz, of 1.4 kB each; 45 min of scan matches, of 12 kB."""
_NOT_KNOWN = -32_768  # the least int16
_DROP_SHARE = 8  # chosen: an eighth of the oldest goes at once, so that it is seldom


@dataclass(slots=True, kw_only=True)
class _Kind:
    time_s: list[float] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)
    size_bytes: int = 0


class Snapshots:
    """Bytes by kind and time; one thread writes, others read. Of too many bytes the oldest go."""

    def __init__(self, limit_bytes: int = _LIMIT_BYTES) -> None:
        self._limit_bytes = limit_bytes
        self._kinds: dict[str, _Kind] = {}
        self._lock = threading.Lock()

    def add(self, kind: str, time_s: float, data: bytes) -> None:
        """Keep the bytes of a time; those of one before the newest are left out."""
        with self._lock:
            kept = self._kinds.setdefault(kind, _Kind())
            if kept.time_s and time_s < kept.time_s[-1]:
                return
            kept.time_s.append(time_s)
            kept.data.append(data)
            kept.size_bytes += len(data)
            if kept.size_bytes > self._limit_bytes:
                drop = max(len(kept.data) // _DROP_SHARE, 1)
                kept.size_bytes -= sum(map(len, kept.data[:drop]))
                del kept.time_s[:drop], kept.data[:drop]

    def at(self, kind: str, time_s: float) -> bytes | None:
        """The newest at or before a time; None without one."""
        with self._lock:
            kept = self._kinds.get(kind)
            place = 0 if kept is None else bisect_right(kept.time_s, time_s)
            return kept.data[place - 1] if kept is not None and place > 0 else None

    def clear(self) -> None:
        """Forget all."""
        with self._lock:
            self._kinds.clear()


def satellites_as_json(message: SatellitesInView, time_s: float) -> bytes:
    """Name, azimuth, elevation [deg], C/N0 [dB-Hz] and use of each satellite; null where it is not known."""
    has_direction, has_cn0 = (message.present & 1).tolist(), (message.present & 2).tolist()
    rows = zip(
        map(satellite_name, message.satellite.tolist()),
        _known(np.degrees(message.azimuth_rad.astype(np.float64)) % 360.0, has_direction),
        _known(np.degrees(message.elevation_rad.astype(np.float64)), has_direction),
        _known(message.cn0_dbhz, has_cn0),
        (SATELLITE_USES[use] for use in message.use.tolist()),
        strict=True,
    )
    return json.dumps({"t": time_s, "quality": message.quality, "satellites": list(rows)}).encode()


def match_points_as_bytes(message: ScanMatchPoints, time_s: float) -> bytes:
    """float64: time, latitude, longitude [deg]; int16 columns: east, north [cm], residual [mm], least: not known."""
    head = np.array([time_s, math.degrees(message.latitude_rad), math.degrees(message.longitude_rad)], "<f8")
    residual_mm = np.where(message.paired, _steps(message.residual_m, 1000.0), _NOT_KNOWN)
    columns = _steps(message.east_m, 100.0), _steps(message.north_m, 100.0), residual_mm
    return head.tobytes() + np.concatenate(columns).astype("<i2").tobytes()


def _steps(values_m: Float32, per_m: float) -> Float64:
    return np.clip(np.rint(values_m.astype(np.float64) * per_m), _NOT_KNOWN + 1, -_NOT_KNOWN - 1)


def _known(values: Float32 | Float64, known: Iterable[int]) -> list[float | None]:
    return [
        round(value, 1) if is_known else None for value, is_known in zip(values.tolist(), known, strict=True)
    ]
