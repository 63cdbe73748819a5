"""Contributions of vehicles, and what a store says of them."""

from __future__ import annotations

import numpy as np

from camber.map_update.admission import Refusal
from camber.map_update.contribution import OBSERVATION, Contribution, Kind
from camber.map_update.stores.store import Judge, Store

NOW_NS = 1_400_000_000 * 1_000_000_000


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


def committed(store: Store, *contributions: Contribution, judge: Judge = take_all) -> list[str]:
    return [outcome.status for outcome in store.commit(contributions, NOW_NS, judge)]


def names_in(store: Store) -> list[tuple[str, str, str]]:
    """Of all contributions, in the order of commits."""
    return [(h.vehicle, h.kind, h.id) for h in store.observations_after(0, 1 << 40).entries]
