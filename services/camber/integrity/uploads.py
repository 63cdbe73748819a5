"""What a vehicle tells the fleet: the road's height under its fixes, free of the map's own, the verdict as a flag.

Epochs that did not pass are uploaded too: were only passed ones sent, a real change of the road would censor itself.
Left out is what no fusion can use: a fix that is not on a known surface, or a height of no accuracy.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import get_args

import numpy as np

from camber.geodesy.gps_time import gpst_from_gps_ns
from camber.integrity.judgement import Judgement
from camber.schemas.fleet import ElevationUpload, UploadBatch
from camber.schemas.integrity import VerdictWord

_VERDICTS: tuple[VerdictWord, ...] = get_args(VerdictWord)
LARGEST_SIGMA_M = 10.0
MOST_ROWS = 64


def upload_for(judgement: Judgement, vehicle: str) -> ElevationUpload | None:
    """The upload of one judgement; None where fix, antenna height or surface is not known well enough."""
    fix, pose, antenna, road = judgement.fix, judgement.pose, judgement.antenna, judgement.road
    if pose is None or road is None or road.surface_id is None or pose.road.map_version is None:
        return None
    if fix.quality != "fixed" or fix.covariance_enu_m2 is None:
        return None
    if antenna is None or antenna.sigma_m is None or antenna.height_m is None or not antenna.height_m >= 0.0:
        return None
    sigma_m = (fix.covariance_enu_m2[5] + antenna.sigma_m**2) ** 0.5
    if not 0.0 < sigma_m <= LARGEST_SIGMA_M:
        return None
    return ElevationUpload(
        time_ns=fix.time_ns,
        vehicle=vehicle,
        upload_id=_name(fix.time_ns, f"{fix.fix_id}".encode()),
        fix_id=fix.fix_id,
        fix_quality=fix.quality,
        verdict=judgement.word,
        latitude_rad=fix.latitude_rad,
        longitude_rad=fix.longitude_rad,
        road_height_m=fix.height_m - antenna.height_m,
        road_height_sigma_m=sigma_m,
        antenna_height_m=antenna.height_m,
        position_covariance_enu_m2=fix.covariance_enu_m2,
        datum=fix.datum,
        epoch_year=_decimal_year(fix.time_ns),
        map_version=pose.road.map_version,
        surface_id=road.surface_id,
    )


def batch_of(uploads: Sequence[ElevationUpload]) -> UploadBatch:
    """Many uploads as one, in their order. Its id is made from its contents: the same uploads are the same batch.

    Raises ValueError where there is none, or where they differ in vehicle, datum or map version.
    """
    headings = {(upload.vehicle, upload.datum, upload.map_version) for upload in uploads}
    if len(headings) != 1:
        raise ValueError(
            f"{len(uploads)} uploads of {len(headings)} vehicles, datums or map versions, expected one"
        )
    (vehicle, datum, map_version), last = headings.pop(), uploads[-1]

    def column(name: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        return np.array([getattr(upload, name) for upload in uploads], "<f8")

    digest = hashlib.sha256("\n".join(upload.model_dump_json() for upload in uploads).encode()).digest()
    return UploadBatch(
        time_ns=last.time_ns,
        vehicle=vehicle,
        batch_id=_name(last.time_ns, digest),
        datum=datum,
        map_version=map_version,
        positioning_time_ns=np.array([upload.time_ns for upload in uploads], "<i8"),
        surface_id=np.array([upload.surface_id for upload in uploads], "<i8"),
        verdict=np.array([_VERDICTS.index(upload.verdict) for upload in uploads], "|u1"),
        latitude_rad=column("latitude_rad"),
        longitude_rad=column("longitude_rad"),
        road_height_m=column("road_height_m"),
        road_height_sigma_m=column("road_height_sigma_m"),
        antenna_height_m=column("antenna_height_m"),
    )


class Collector:
    """Collects uploads into batches: of one map version and datum, of one stretch of time, of at most 64 rows.

    The stretches lie on the grid of GPS time, so that a drive judged again gives the same batches.
    """

    def __init__(self, every_s: float) -> None:
        self._every_ns = round(every_s * 1e9)
        self._rows: list[ElevationUpload] = []

    def add(self, upload: ElevationUpload) -> UploadBatch | None:
        """Take one; returns the batch that ends before it, if one does."""
        first = self._rows[0] if self._rows else upload
        same = (upload.datum, upload.map_version) == (first.datum, first.map_version)
        full = (
            len(self._rows) >= MOST_ROWS
            or not same
            or self._stretch(upload.time_ns) != self._stretch(first.time_ns)
        )
        batch = self.take() if full else None
        self._rows.append(upload)
        return batch

    def due(self, now_ns: int) -> UploadBatch | None:
        """The batch whose stretch of time is over, if there is one."""
        over = self._rows and self._stretch(now_ns) != self._stretch(self._rows[0].time_ns)
        return self.take() if over else None

    def take(self) -> UploadBatch | None:
        """All that has been collected."""
        rows, self._rows = self._rows, []
        return batch_of(rows) if rows else None

    def _stretch(self, time_ns: int) -> int:
        return time_ns // self._every_ns


def _name(time_ns: int, content: bytes) -> str:
    """Named by what was measured: the same uploaded twice, also after a restart, is one upload."""
    return f"{time_ns}-{hashlib.sha256(b'%d:%b' % (time_ns, content)).hexdigest()[:16]}"


def _decimal_year(time_ns: int) -> float:
    calendar = gpst_from_gps_ns(time_ns)
    return calendar.year + (calendar.month - 1) / 12.0 + (calendar.day - 1) / 365.25
