"""A contribution: one upload or one batch of a vehicle, with its observations as rows of one dtype."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from camber.schemas.fleet import ElevationUpload, UploadBatch
from camber.schemas.gnss import Quality
from camber.schemas.integrity import VerdictValue

VERDICTS: tuple[VerdictValue, ...] = get_args(VerdictValue)
"""`verdict` of a row, and of UploadBatch, is an index into this."""
QUALITIES: tuple[Quality, ...] = get_args(Quality)
"""`fix_quality` of a row, and of UploadBatch, is an index into this."""

OBSERVATION = np.dtype(
    [
        ("time_ns", "<i8"),
        ("fix_id", "<i8"),
        ("fix_quality", "|u1"),
        ("surface_id", "<i8"),
        ("verdict", "|u1"),
        ("latitude_rad", "<f8"),
        ("longitude_rad", "<f8"),
        ("horizontal_sigma_m", "<f8"),
        ("road_height_m", "<f8"),
        ("road_height_sigma_m", "<f8"),
        ("antenna_height_m", "<f8"),
    ]
)
"""One observation of a road height. Names are those of ElevationUpload; times are positioning times."""

Kind = Literal["upload", "batch"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Contribution:
    """Observations (n,) of OBSERVATION with what they have in common; (vehicle, kind, id) identifies them.

    A batch has no covariances of its fixes, only their largest horizontal σ.
    """

    vehicle: str
    kind: Kind
    id: str
    datum: str
    map_version: int
    epoch_year: float
    position_covariance_enu_m2: tuple[float, ...] | None
    observations: npt.NDArray[np.void]

    @property
    def name(self) -> tuple[str, str, str]:
        """(vehicle, kind, id)."""
        return self.vehicle, self.kind, self.id

    def digest(self) -> bytes:
        """Return the SHA-256 of the content without the name: equal when the same content is sent again."""
        header = (self.datum, self.map_version, self.epoch_year, self.position_covariance_enu_m2)
        return hashlib.sha256(repr(header).encode() + self.observations.tobytes()).digest()


def from_upload(upload: ElevationUpload) -> Contribution:
    """Return the contribution of a single upload."""
    ee, en, _, nn, _, _ = upload.position_covariance_enu_m2
    values = {name: getattr(upload, name, None) for name in OBSERVATION.names or ()} | {
        "fix_quality": QUALITIES.index(upload.fix_quality),
        "verdict": VERDICTS.index(upload.verdict),
        "horizontal_sigma_m": math.sqrt(max(0.5 * (ee + nn) + math.hypot(0.5 * (ee - nn), en), 0.0)),
    }
    rows = np.array([tuple(values.values())], OBSERVATION)
    covariance = upload.position_covariance_enu_m2
    return _contribution(
        upload, kind="upload", id=upload.upload_id, position_covariance_enu_m2=covariance, observations=rows
    )


def from_batch(batch: UploadBatch) -> Contribution:
    """Return the contribution of a batch."""
    rows = np.empty(len(batch.positioning_time_ns), OBSERVATION)
    for name in OBSERVATION.names or ():
        rows[name] = batch.positioning_time_ns if name == "time_ns" else getattr(batch, name)
    return _contribution(
        batch, kind="batch", id=batch.batch_id, position_covariance_enu_m2=None, observations=rows
    )


def _contribution(message: ElevationUpload | UploadBatch, **fields: Any) -> Contribution:
    common = {name: getattr(message, name) for name in ("vehicle", "datum", "map_version", "epoch_year")}
    return Contribution(**common, **fields)
