"""From what vehicles observed to what becomes of the map: the steps in their order.

    observations  → votes_from → merged → kept            as batches arrive (votes.py, slots.py)
    votes         → biases → heights → decisions          now and then, of a region at a time

A `Fusion` belongs to one reference release: offsets are against its heights. Nothing here knows a clock or a store.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from camber.map_update.fusion.biweight import ChangeRule, Heights, heights_of
from camber.map_update.fusion.publication import Decisions, PublicationRules, decided
from camber.map_update.fusion.surface_neighbours import surroundings_of
from camber.map_update.fusion.surface_shape import shapes_of, votes_shape_m2
from camber.map_update.fusion.vehicle_bias import Biases, BiasModel, biases_of
from camber.map_update.fusion.vote_slots import Slots, kept
from camber.map_update.fusion.votes import (
    KEY,
    Floats,
    Gate,
    Integers,
    Votes,
    checked_secret,
    merged,
    session_of,
    values_of,
    voter_of,
    votes_from,
)
from camber.road_map.road_columns import RoadSurfaces
from camber.road_map.surface_heights import SurfaceHeights


@dataclass(frozen=True, slots=True)
class Rules:
    """By what it is decided; each part says what its fields mean."""

    gate: Gate = field(default_factory=Gate)
    """Which observations are of use."""
    slots: Slots = field(default_factory=Slots)
    """How many votes are kept, and how long."""
    bias: BiasModel = field(default_factory=BiasModel)
    """What is believed of vehicles before there are data."""
    change: ChangeRule = field(default_factory=ChangeRule)
    """When votes of before are of a road that is no more, and how many may be lying."""
    publication: PublicationRules = field(default_factory=PublicationRules)
    """When a change is published."""
    street_m: float = 300.0
    """Side of the squares that count as one street: a bias is predicted from the others."""
    region_m: float = 1000.0
    """Side of the squares that are watched for common shifts."""


@dataclass(frozen=True, slots=True, eq=False)
class FusionEstimates:
    """What the decisions rest on: of the votes that were kept, and of surfaces (n,) by `row` of the surroundings."""

    votes: Votes
    biases: Biases
    row: Integers
    heights: Heights
    common_error_m: Floats
    shape_m: Floats


class Fusion:
    """Fusion against one reference release, of one secret, by one set of rules."""

    def __init__(self, surfaces: RoadSurfaces, secret: bytes, rules: Rules | None = None) -> None:
        self.rules = rules or Rules()
        self._secret = checked_secret(secret)
        self._reference = SurfaceHeights(surfaces)
        self.surroundings = surroundings_of(
            surfaces, street_m=self.rules.street_m, region_m=self.rules.region_m
        )
        # Its sessions are days of solar time; a region's easternmost surface is the first to have a new one.
        self._east_rad = float(surfaces.longitude_rad.max(initial=-np.pi))

    def votes_from(self, observations: NDArray[np.void], vehicle: str) -> Votes:
        """Votes of observations (n,) of OBSERVATION of one vehicle; see `votes.votes_from`."""
        return self.votes_of_voters(observations, voter_of(vehicle, self._secret))

    def votes_of_voters(self, observations: NDArray[np.void], voter: Integers | int) -> Votes:
        """The same of many vehicles at once, by `voter_of` (n,)."""
        return votes_from(observations, voter, self._reference, self._secret, self.rules.gate)

    def voter_of(self, vehicle: str) -> int:
        """The pseudonym of a vehicle."""
        return voter_of(vehicle, self._secret)

    def merge(self, *votes: Votes) -> Votes:
        """Votes of several sets as one; in any order, and more than once."""
        return merged(*votes)

    def kept(self, votes: Votes, now_ns: int) -> Votes:
        """Those of votes, one of each key, that have a slot at GPS time `now_ns`; the others may be deleted."""
        return kept(votes, self._secret, self.rules.slots, newest_session=self._today(now_ns))

    def decide(
        self, votes: Votes, corrected_surface_id: Integers, correction_m: Floats, now_ns: int
    ) -> Decisions:
        """Decide of all surfaces that have votes (n,), which are as `merge` gives them.

        `correction_m` (k,) are the offsets against the reference that the map has at present at
        `corrected_surface_id` (k,); elsewhere it has none. Raises ValueError where votes are not in order.
        """
        fused = self.fuse(votes, now_ns)
        correction = np.zeros(len(self.surroundings.surface_id))
        corrected = self.surroundings.rows_of(np.asarray(corrected_surface_id, np.int64))
        correction[corrected[corrected >= 0]] = np.asarray(correction_m, np.float64)[corrected >= 0]
        return decided(
            fused.row,
            fused.heights,
            fused.common_error_m,
            fused.shape_m,
            correction[fused.row],
            self.surroundings,
            self.rules.publication,
        )

    def fuse(self, votes: Votes, now_ns: int) -> FusionEstimates:
        """Biases and heights of votes as `decide` takes them."""
        _check_order(votes)
        votes = self.kept(votes, now_ns)
        row = self.surroundings.rows_of(np.ascontiguousarray(votes["surface_id"]))
        votes, row = votes[row >= 0], row[row >= 0]
        surface, begins = np.unique(row, return_index=True)
        begins = np.append(begins, len(votes))
        voter, session = np.ascontiguousarray(votes["voter"]), np.ascontiguousarray(votes["session"])
        value_m, sigma_m, variance_m2 = values_of(votes)
        shape_m = shapes_of(begins, variance_m2)
        biases = biases_of(
            begins,
            self.surroundings.block[row],
            voter,
            session,
            value_m,
            sigma_m,
            votes_shape_m2(shape_m),
            self.rules.bias,
        )
        heights = heights_of(
            begins,
            voter,
            session,
            value_m - biases.bias_m,
            biases.weight,
            biases.known,
            biases.components.vote_m,
            self.rules.change,
        )
        return FusionEstimates(
            votes, biases, surface, heights, _common_errors(begins, voter, biases), shape_m
        )

    def _today(self, now_ns: int) -> int:
        return int(session_of(np.array([now_ns]), np.array([self._east_rad]))[0])


def _common_errors(begins: Integers, voter: Integers, biases: Biases) -> Floats:
    """What is left open of each surface's height by the biases that its vehicles have in common.

    Votes tell biases apart, never their mean over the vehicles, which is N(0, vehicle² / voters + session² / votes).
    Which vehicles those are is read off the surfaces: a voter is compared with as many as it meets where it meets most.
    """
    if len(voter) == 0:
        return np.zeros(0)
    votes = np.diff(begins)
    first = np.ones(len(voter), bool)
    first[1:] = voter[1:] != voter[:-1]
    first[begins[:-1]] = True
    voters = np.add.reduceat(first.astype(np.float64), begins[:-1])
    _, who = np.unique(voter, return_inverse=True)
    most_voters, most_votes = np.zeros(biases.voters), np.zeros(biases.voters)
    np.maximum.at(most_voters, who, np.repeat(voters, votes))
    np.maximum.at(most_votes, who, np.repeat(votes.astype(np.float64), votes))
    voters_met = np.add.reduceat(most_voters[who], begins[:-1]) / votes
    votes_met = np.add.reduceat(most_votes[who], begins[:-1]) / votes
    parts = biases.components
    common_m: Floats = np.sqrt(parts.vehicle_m**2 / voters_met + parts.session_m**2 / votes_met)
    return common_m


def _check_order(votes: Votes) -> None:
    """ValueError unless votes are in ascending order of their keys, each key once."""
    if len(votes) < 2:
        return
    before, after = votes[:-1], votes[1:]
    ascends, same = np.zeros(len(before), bool), np.ones(len(before), bool)
    for name in KEY:
        ascends |= same & (after[name] > before[name])
        same &= after[name] == before[name]
    if not ascends.all():
        at = int(np.argmin(ascends)) + 1
        raise ValueError(
            f"votes: row {at} is not after the one before it, expected them as `merge` gives them"
        )
