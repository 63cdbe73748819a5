"""Which votes are kept: a bounded number for each surface and period, drawn by a keyed hash.

Of each surface and period the voters with the lowest hash of (key, surface, period, voter) are kept, and of each of
them the sessions with the lowest hash (bottom-k or min-wise sampling: Broder 1997, "On the resemblance and containment
of documents"). Every voter is equally likely to be kept, whenever and however often it drives by, and nobody without
the key can choose a name that is kept. A share of the voters of a street has the same share of its slots, up to
sampling: slots are filled by names, not by votes.

Each **period** has its own slots, so that old votes do not outvote a road that changed, and today's crowd does not
displace last week's votes. Only the latest periods are kept.

Thinning a union gives the same votes as thinning the union of thinned sets, so votes can be thinned as they arrive.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.map_update.fusion.votes import Integers, Votes, check_secret, splitmix64


@dataclass(frozen=True, slots=True, kw_only=True)
class SlotLimits:
    """Limits of a surface: at most periods × voters × sessions votes; sessions are of one voter in one period."""

    period_days: int = 7
    periods: int = 8
    voters: int = 64
    sessions: int = 2


def thin_votes(votes: Votes, secret: bytes, limits: SlotLimits, *, newest_session: int) -> Votes:
    """Return those of `votes` (n,), one of each key, that have a slot, in their order.

    Kept are `limits.periods` periods up to that of `newest_session` (today); votes of later periods are dropped too.
    """
    period = votes["session"] // limits.period_days
    newest = newest_session // limits.period_days
    recent = np.flatnonzero((period <= newest) & (period > newest - limits.periods))
    candidates, period = votes[recent], period[recent]
    key = np.frombuffer(
        hashlib.blake2b(b"slots", digest_size=16, key=check_secret(secret)).digest(), np.uint64
    )
    surface_id, voter, session = (candidates[name] for name in ("surface_id", "voter", "session"))
    voter_rank, session_rank = _ranks(
        surface_id, period, voter=voter, session=session, voter_key=key[0], session_key=key[1]
    )
    order = np.lexsort((session_rank, voter, voter_rank, period, surface_id))
    has_slot = np.zeros(len(candidates), bool)
    has_slot[order] = _within_limits(
        surface_id[order],
        period[order],
        voter[order],
        most_voters=limits.voters,
        most_sessions=limits.sessions,
    )
    return votes[recent[has_slot]]


@compiled
def _ranks(
    surface_id: Integers,
    period: Integers,
    voter: Integers,
    session: Integers,
    voter_key: np.uint64,
    session_key: np.uint64,
) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    voter_rank, session_rank = np.empty(len(voter), np.uint64), np.empty(len(voter), np.uint64)
    for i in range(len(voter)):
        state = splitmix64(voter_key ^ np.uint64(surface_id[i]))
        voter_rank[i] = splitmix64(splitmix64(state ^ np.uint64(period[i])) ^ np.uint64(voter[i]))
        session_rank[i] = splitmix64(splitmix64(session_key ^ voter_rank[i]) ^ np.uint64(session[i]))
    return voter_rank, session_rank


@compiled
def _within_limits(
    surface_id: Integers, period: Integers, voter: Integers, most_voters: int, most_sessions: int
) -> NDArray[np.bool_]:
    """Return which rows, sorted by surface, period, voter rank and session rank, are among the first of each."""
    within = np.zeros(len(voter), np.bool_)
    voters, sessions = 0, 0
    for i in range(len(voter)):
        if i == 0 or surface_id[i] != surface_id[i - 1] or period[i] != period[i - 1]:
            voters, sessions = 1, 1
        elif voter[i] != voter[i - 1]:
            voters, sessions = voters + 1, 1
        else:
            sessions += 1
        within[i] = voters <= most_voters and sessions <= most_sessions
    return within
