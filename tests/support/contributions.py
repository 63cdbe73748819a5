"""Contributions of vehicles, and what a store says of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from camber.map_update.admission import Refusal
from camber.map_update.contribution import OBSERVATION, Contribution, Kind
from camber.map_update.stores.store import Store
from camber.map_update.stores.upload_deduplication import RefusalCheck
from camber.schemas.fleet import ElevationUpload, UploadBatch

NOW_NS = 1_400_000_000 * 1_000_000_000
_HEADING = {"vehicle": "v1", "datum": "WGS84", "epoch_year": 2024.5, "map_version": 3}
UPLOAD: dict[str, Any] = _HEADING | {
    "time_ns": NOW_NS - 1000,
    "upload_id": "u1",
    "fix_id": 7,
    "fix_quality": "fixed",
    "verdict": "erroneous",
    "latitude_rad": 0.61,
    "longitude_rad": 2.39,
    "road_height_m": 41.25,
    "road_height_sigma_m": 0.05,
    "antenna_height_m": 1.7,
    "position_covariance_enu_m2": (1.0, 0.1, 0.2, 1.5, 0.3, 2.0),
    "surface_id": 99,
}


def upload(**changes: Any) -> ElevationUpload:
    return ElevationUpload(**UPLOAD | changes)


def batch(records: int = 4, **changes: Any) -> UploadBatch:
    columns = {
        "positioning_time_ns": np.full(records, NOW_NS - 5),
        "fix_id": np.arange(records),
        "fix_quality": np.zeros(records, np.uint8),
        "surface_id": np.arange(records),
        "verdict": np.full(records, 2, np.uint8),
        "latitude_rad": np.full(records, 0.61),
        "longitude_rad": np.full(records, 2.39),
        "horizontal_sigma_m": np.full(records, 0.03),
        "road_height_m": np.linspace(40.0, 41.0, records),
        "road_height_sigma_m": np.full(records, 0.05),
        "antenna_height_m": np.full(records, 1.7),
    }
    return UploadBatch(**_HEADING | {"time_ns": NOW_NS, "batch_id": "b1"} | columns | changes)


def contribution(
    name: str,
    *,
    vehicle: str = "v1",
    kind: Kind = "upload",
    height_m: float = 40.0,
    datum: str = "WGS84",
    records: int = 1,
) -> Contribution:
    rows = np.zeros(records, OBSERVATION)
    rows["time_ns"] = NOW_NS + np.arange(records)
    rows["latitude_rad"], rows["longitude_rad"] = 0.61, 2.39
    rows["road_height_m"] = height_m
    return Contribution(
        vehicle=vehicle,
        kind=kind,
        id=name,
        datum=datum,
        map_version=1,
        epoch_year=2024.0,
        position_covariance_enu_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 4.0) if kind == "upload" else None,
        observations=rows,
    )


def random_batch(name: str, records: int, rng: np.random.Generator) -> Contribution:
    """A batch of any numbers, its rows in order of time."""
    batch = contribution(name, kind="batch", records=records)
    for field in OBSERVATION.names or ():
        limit = {"verdict": 4, "fix_quality": 8}.get(field, 2**62)
        integers = OBSERVATION[field].kind in "iu"
        batch.observations[field] = (
            rng.integers(0, limit, records) if integers else rng.normal(0.0, 1e3, records)
        )
    batch.observations["time_ns"].sort()
    return batch


def take_all(_: Contribution) -> None:
    return None


def refuse_all(_: Contribution) -> Refusal:
    return Refusal("datum", "datum Tokyo, expected WGS84")


def refuse_tokyo(candidate: Contribution) -> Refusal | None:
    return refuse_all(candidate) if candidate.datum == "Tokyo" else None


def committed(store: Store, *contributions: Contribution, refusal_of: RefusalCheck = take_all) -> list[str]:
    return [outcome.status for outcome in store.commit(contributions, NOW_NS, refusal_of)]


def names_in(store: Store) -> list[tuple[str, str, str]]:
    """Of all contributions, in the order of commits."""
    return [(h.vehicle, h.kind, h.id) for h in store.observations_after(0, 1 << 40).entries]
