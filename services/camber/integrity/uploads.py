"""Uploads of a vehicle to the fleet: the road's height under its fixes, free of the map's own, the verdict as a flag.

Epochs that did not pass are uploaded too: were only passed ones sent, a real change of the road would censor itself.
The height is h_r − h_a alone, without the learnt correction, and h_a is never that of scan matching: it is above the
road *of the map*, and would give back the map's own height where the road has changed. Left out is what no fusion can
use: a fix that is not on a known surface, or a height of no accuracy.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.covariance import eigenvalues_m2
from camber.geodesy.gps_time import gpst_from_gps_ns
from camber.integrity.judgement import FixJudgement
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.schemas.antenna import AntennaHeight
from camber.schemas.fleet import ElevationUpload, UploadBatch
from camber.schemas.gnss import Quality
from camber.schemas.integrity import VerdictValue

_VERDICTS: tuple[VerdictValue, ...] = get_args(VerdictValue)
_QUALITIES: tuple[Quality, ...] = get_args(Quality)
LARGEST_SIGMA_M = 10.0  # as map_update.admission's default of `largest_sigma_m`: it refuses more
MOST_ROWS = 64  # chosen: 5 s at 10 Hz are 50 rows
_DAY_NS = 86_400_000_000_000  # 24 h of 3600 s


def upload_for(judgement: FixJudgement, vehicle: str, sigma: TrueSigma) -> ElevationUpload | None:
    """The upload of one judgement; None where fix, antenna height or surface is not known well enough."""
    fix, pose, road = judgement.fix, judgement.pose, judgement.road
    if pose is None or road is None or road.surface_id is None or pose.road.map_version is None:
        return None
    if fix.quality != "fixed" or fix.covariance_enu_m2 is None:
        return None
    antenna = _free_of_the_map(judgement.antenna)
    if antenna is None or not antenna[0] >= 0.0:
        return None
    antenna_m, antenna_sigma_m = antenna
    covariance_m2 = inflate_covariance(fix.covariance_enu_m2, sigma)
    sigma_m = math.hypot(math.sqrt(covariance_m2[5]), antenna_sigma_m)
    if not sigma_m <= LARGEST_SIGMA_M:
        return None
    return ElevationUpload(
        time_ns=fix.time_ns,
        vehicle=vehicle,
        upload_id=_name(fix.time_ns, f"{fix.fix_id}".encode()),
        fix_id=fix.fix_id,
        fix_quality=fix.quality,
        verdict=judgement.verdict,
        latitude_rad=fix.latitude_rad,
        longitude_rad=fix.longitude_rad,
        road_height_m=fix.height_m - antenna_m,
        road_height_sigma_m=sigma_m,
        antenna_height_m=antenna_m,
        position_covariance_enu_m2=covariance_m2,
        datum=fix.datum,
        epoch_year=decimal_year(fix.time_ns),
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

    def column(name: str) -> NDArray[Any]:
        return np.array([getattr(upload, name) for upload in uploads])

    digest = hashlib.sha256("\n".join(upload.model_dump_json() for upload in uploads).encode()).digest()
    return UploadBatch(
        time_ns=last.time_ns,
        vehicle=vehicle,
        batch_id=_name(last.time_ns, digest),
        datum=datum,
        epoch_year=uploads[0].epoch_year,
        map_version=map_version,
        positioning_time_ns=column("time_ns"),
        fix_id=column("fix_id"),
        fix_quality=np.array([_QUALITIES.index(upload.fix_quality) for upload in uploads], "|u1"),
        surface_id=column("surface_id"),
        verdict=np.array([_VERDICTS.index(upload.verdict) for upload in uploads], "|u1"),
        latitude_rad=column("latitude_rad"),
        longitude_rad=column("longitude_rad"),
        horizontal_sigma_m=np.array([_horizontal_sigma_m(upload) for upload in uploads]),
        road_height_m=column("road_height_m"),
        road_height_sigma_m=column("road_height_sigma_m"),
        antenna_height_m=column("antenna_height_m"),
    )


class UploadBatcher:
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


def _free_of_the_map(antenna: AntennaHeight | None) -> tuple[float, float] | None:
    """Antenna height and its σ by a way that owes nothing to the map: the one chosen, or the surest of the others."""
    if antenna is None or antenna.height_m is None or antenna.sigma_m is None:
        return None
    if antenna.way != "scan_matching":
        return antenna.height_m, antenna.sigma_m
    others = [other for other in antenna.others if other.way != "scan_matching"]
    surest = min(others, key=lambda other: other.sigma_m, default=None)
    return None if surest is None else (surest.height_m, surest.sigma_m)


def _horizontal_sigma_m(upload: ElevationUpload) -> float:
    """σ in the worst direction."""
    ee, en, _, nn, _, _ = upload.position_covariance_enu_m2
    return math.sqrt(eigenvalues_m2((ee, en, nn))[0])


def _name(time_ns: int, content: bytes) -> str:
    """Named by what was measured: the same uploaded twice, also after a restart, is one upload."""
    return f"{time_ns}-{hashlib.sha256(b'%d:%b' % (time_ns, content)).hexdigest()[:16]}"


def decimal_year(time_ns: int) -> float:
    """The epoch of a GPS time as geodesists write it, to about two days."""
    return _decimal_year(time_ns // _DAY_NS)


@lru_cache(maxsize=16)
def _decimal_year(day: int) -> float:
    calendar = gpst_from_gps_ns(day * _DAY_NS)
    return calendar.year + (calendar.month - 1) / 12.0 + (calendar.day - 1) / 365.25
