"""The fusion pipeline, from observations of vehicles to decisions about the map.

    observations  → votes_from → merge → thin             as batches arrive (votes.py, vote_slots.py)
    votes         → biases → heights → decisions          periodically, for one region at a time

A `Fusion` belongs to one reference release: offsets are relative to its heights. It has no clock and no store.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from camber.map_update.fusion.publication_decision import Decisions, PublicationSettings, decide
from camber.map_update.fusion.robust_surface_heights import VoteColumns, estimate_heights
from camber.map_update.fusion.surface_neighbours import build_neighbourhood
from camber.map_update.fusion.surface_shape import shape_spread, shape_variance_m2
from camber.map_update.fusion.vehicle_bias import Biases, estimate_biases
from camber.map_update.fusion.vote_slots import SlotLimits, thin_votes
from camber.map_update.fusion.votes import (
    KEY,
    Floats,
    Integers,
    Votes,
    check_secret,
    session_of,
    vote_values,
    voter_of,
    votes_from,
)
from camber.road_map.height_interpolation import SurfaceHeights
from camber.road_map.road_columns import RoadSurfaces

_REGION_M = 1000.0  # chosen: side of the squares monitored for common shifts, a few streets each


class FusionSettings(PublicationSettings):
    """Parameters of the fusion."""

    street_m: float = Field(
        300.0,
        ge=10.0,
        le=10_000.0,
        description="side of the squares that count as one street: a vehicle's bias there is predicted from the others",
    )


class Fusion:
    """Fusion against one reference release, with one secret for pseudonyms and sampling."""

    def __init__(self, surfaces: RoadSurfaces, secret: bytes, settings: FusionSettings | None = None) -> None:
        self._settings = settings = settings or FusionSettings()
        self._secret = check_secret(secret)
        self.roads = SurfaceHeights(surfaces)
        self.neighbourhood = build_neighbourhood(surfaces, street_m=settings.street_m, region_m=_REGION_M)
        # Sessions are days of solar time; a region's easternmost surface is the first to have a new one.
        self._east_rad = float(surfaces.longitude_rad.max(initial=-np.pi))

    def votes_from(self, observations: NDArray[np.void], voter: Integers | int) -> Votes:
        """Return the votes of observations (n,) of OBSERVATION; `voter` is (n,) or one, by `voter_of`."""
        return votes_from(observations, voter, reference=self.roads, secret=self._secret)

    def voter_of(self, vehicle: str) -> int:
        """Return the pseudonym of a vehicle."""
        return voter_of(vehicle, self._secret)

    def thin(self, votes: Votes, now_ns: int) -> Votes:
        """Return those of votes, one of each key, that have a slot at GPS time `now_ns`; the others may be deleted."""
        today = int(session_of(np.array([now_ns]), np.array([self._east_rad]))[0])
        return thin_votes(votes, self._secret, SlotLimits(), newest_session=today)

    def decide(
        self, votes: Votes, corrected_surface_id: Integers, correction_m: Floats, now_ns: int
    ) -> Decisions:
        """Decide on all surfaces that have votes (n,), which are as `merge_votes` returns them.

        `correction_m` (k,) are the present offsets of the map from the reference at `corrected_surface_id` (k,); other
        surfaces have none. Raises ValueError for votes that are not sorted.
        """
        _check_order(votes)
        votes = self.thin(votes, now_ns)
        row = self.neighbourhood.rows_of(np.ascontiguousarray(votes["surface_id"]))
        votes, row = votes[row >= 0], row[row >= 0]
        surface, begins = np.unique(row, return_index=True)
        begins = np.append(begins, len(votes))
        voter, session = np.ascontiguousarray(votes["voter"]), np.ascontiguousarray(votes["session"])
        value_m, sigma_m, variance_m2 = vote_values(votes)
        shape_m = shape_spread(begins, variance_m2)
        biases = estimate_biases(
            begins,
            block=self.neighbourhood.block[row],
            voter=voter,
            session=session,
            value_m=value_m,
            sigma_m=sigma_m,
            shape_m2=shape_variance_m2(shape_m),
        )
        heights = estimate_heights(
            begins,
            VoteColumns(voter=voter, session=session, value_m=value_m - biases.bias_m, weight=biases.weight),
            known=biases.known,
            vote_sigma_m=biases.components.vote_m,
        )
        correction = np.zeros(len(self.neighbourhood.surface_id))
        corrected = self.neighbourhood.rows_of(np.asarray(corrected_surface_id, np.int64))
        correction[corrected[corrected >= 0]] = np.asarray(correction_m, np.float64)[corrected >= 0]
        return decide(
            surface,
            heights,
            common_error_m=_common_errors(begins, voter, biases),
            shape_m=shape_m,
            correction_m=correction[surface],
            neighbourhood=self.neighbourhood,
            settings=self._settings,
        )


def _common_errors(begins: Integers, voter: Integers, biases: Biases) -> Floats:
    """Return the standard error of each surface's height due to the mean bias of its vehicles.

    Votes determine the differences of biases, never their mean over the vehicles, which is
    N(0, vehicle² / voters + session² / votes). The number of vehicles a voter is compared with is that of the surface
    on which it meets most.
    """
    if len(voter) == 0:
        return np.zeros(0)
    votes = np.diff(begins)
    first = np.ones(len(voter), bool)
    first[1:] = voter[1:] != voter[:-1]
    first[begins[:-1]] = True
    voters = np.add.reduceat(first.astype(np.float64), begins[:-1])
    _, number = np.unique(voter, return_inverse=True)
    most_voters, most_votes = np.zeros(biases.voters), np.zeros(biases.voters)
    np.maximum.at(most_voters, number, np.repeat(voters, votes))
    np.maximum.at(most_votes, number, np.repeat(votes.astype(np.float64), votes))
    voters_met = np.add.reduceat(most_voters[number], begins[:-1]) / votes
    votes_met = np.add.reduceat(most_votes[number], begins[:-1]) / votes
    components = biases.components
    common_m: Floats = np.sqrt(components.vehicle_m**2 / voters_met + components.session_m**2 / votes_met)
    return common_m


def _check_order(votes: Votes) -> None:
    """Raise ValueError unless votes are in ascending order of their keys, each key once."""
    if len(votes) < 2:
        return
    before, after = votes[:-1], votes[1:]
    ascends, same = np.zeros(len(before), bool), np.ones(len(before), bool)
    for name in KEY:
        ascends |= same & (after[name] > before[name])
        same &= after[name] == before[name]
    if not ascends.all():
        at = int(np.argmin(ascends)) + 1
        raise ValueError(f"votes: row {at} is not after the one before it, expected them sorted by key")
