"""Changes of the map (pending, held, published, alarmed) with their places, and votes by day, as messages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.map_update.fusion.correction_rows import Corrections
from camber.map_update.fusion.publication_decision import REASONS, Decisions
from camber.map_update.fusion.surface_neighbours import SurfaceNeighbourhood
from camber.map_update.fusion.votes import Votes, vote_values
from camber.schemas.fleet import (
    HELD_REASONS,
    HeldChanges,
    MapChanges,
    MapVotes,
    PublishedChanges,
    RegionAlarms,
)
from camber.schemas.road import ReleaseRoot

MOST_ROWS = 1000
"""Of a kind. Chosen: 64, 64, 52 and 29 bytes a row stay within a reply of 256 kB."""
LEAST_VEHICLES = 3
"""Of a day whose quartiles are sent. Chosen: the median of fewer is the vote of one, or gives it away."""
UNIX_DAY_OF_GPS_EPOCH = 3657  # 6 January 1980
_HELD_NUMBER = np.array([HELD_REASONS.index(r) if r in HELD_REASONS else 0 for r in REASONS], np.uint8)


def map_changes(
    decisions: Decisions,
    corrections: Corrections,
    neighbourhood: SurfaceNeighbourhood,
    *,
    root: ReleaseRoot,
    reference_sha256: str,
    time_ns: int,
) -> MapChanges:
    """The held ones by size, the published ones newest first; what has no room is counted.

    A correction of zero is no change: such a height was confirmed, or the change withdrawn.
    """
    held = decisions.of("hold")
    change_m = np.abs(held["offset_m"] - held["previous_correction_m"])
    held = held[np.argsort(-change_m, kind="stable")]
    published = corrections[corrections["offset_m"] != 0.0]
    published = published[np.argsort(-published["since_map_version"], kind="stable")]
    waiting = decisions.pending()
    parts = [rows[neighbourhood.rows_of(rows["surface_id"]) >= 0] for rows in (held, published, waiting)]
    alarms = decisions.alarms
    return MapChanges(
        time_ns=time_ns,
        status="known",
        map_version=root.map_version,
        reference_sha256=reference_sha256,
        held=_held(parts[0][:MOST_ROWS], neighbourhood),
        published=_published(parts[1][:MOST_ROWS], neighbourhood),
        pending=_held(parts[2][:MOST_ROWS], neighbourhood),
        alarms=_alarms(alarms[:MOST_ROWS], neighbourhood),
        left_out=sum(max(len(rows) - MOST_ROWS, 0) for rows in (*parts, alarms)),
    )


def votes_by_day(votes: Votes, *, time_ns: int) -> MapVotes:
    """The votes on one surface, those of each day together: a vehicle has one a day.

    Days of fewer than LEAST_VEHICLES are counted alone, because quartiles would be the votes of one.
    """
    value_m = vote_values(votes)[0]
    day = votes["session"] + UNIX_DAY_OF_GPS_EPOCH
    every, vehicles = np.unique(day, return_counts=True)
    shown = vehicles >= LEAST_VEHICLES
    days = every[shown]
    shares = np.array([np.quantile(value_m[day == each], (0.25, 0.5, 0.75)) for each in days.tolist()])
    low_m, offset_m, high_m = shares.reshape(-1, 3).T.astype(np.float32)
    return MapVotes(
        time_ns=time_ns,
        status="known",
        day=days.astype(np.int32),
        vehicles=vehicles[shown].astype(np.int32),
        offset_m=offset_m.copy(),
        low_m=low_m.copy(),
        high_m=high_m.copy(),
        left_out=int((~shown).sum()),
    )


def _held(rows: NDArray[np.void], neighbourhood: SurfaceNeighbourhood) -> HeldChanges:
    at = neighbourhood.rows_of(rows["surface_id"])
    return HeldChanges(
        surface_id=rows["surface_id"].copy(),
        link_id=neighbourhood.link_id[at],
        latitude_rad=neighbourhood.latitude_rad[at],
        longitude_rad=neighbourhood.longitude_rad[at],
        in_map_m=rows["previous_correction_m"].astype(np.float32),
        offset_m=rows["offset_m"].astype(np.float32),
        standard_error_m=rows["standard_error_m"].astype(np.float32),
        agreement=rows["agreement"].astype(np.float32),
        vehicles=rows["vehicles"].astype(np.int32),
        votes=rows["votes"].astype(np.int32),
        days=rows["days"].astype(np.int32),
        reason=_HELD_NUMBER[rows["reason"]],
    )


def _published(rows: Corrections, neighbourhood: SurfaceNeighbourhood) -> PublishedChanges:
    at = neighbourhood.rows_of(rows["surface_id"])
    return PublishedChanges(
        surface_id=rows["surface_id"].copy(),
        link_id=neighbourhood.link_id[at],
        latitude_rad=neighbourhood.latitude_rad[at],
        longitude_rad=neighbourhood.longitude_rad[at],
        offset_m=rows["offset_m"].astype(np.float32),
        sigma_m=rows["sigma_m"].astype(np.float32),
        vehicles=rows["vehicles"].astype(np.int32),
        since_map_version=rows["since_map_version"].copy(),
    )


def _alarms(rows: NDArray[np.void], neighbourhood: SurfaceNeighbourhood) -> RegionAlarms:
    everywhere = rows["region"] < 0
    region = neighbourhood.region
    inside = [(region == number) | (number < 0) for number in rows["region"].tolist()]
    return RegionAlarms(
        everywhere=everywhere.astype(np.uint8),
        latitude_rad=np.array([neighbourhood.latitude_rad[at].mean() for at in inside], np.float64),
        longitude_rad=np.array([neighbourhood.longitude_rad[at].mean() for at in inside], np.float64),
        shift_m=rows["shift_m"].astype(np.float32),
        share=rows["share"].astype(np.float32),
        surfaces=rows["surfaces"].astype(np.int32),
    )
