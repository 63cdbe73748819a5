"""Which votes are kept: a bounded number for each surface and period, drawn by a keyed hash.

Of a surface and a period the voters whose hash of (key, surface, period, voter) is lowest are kept, and of each of
them the sessions whose hash is (bottom-k or min-wise sampling: Broder 1997, "On the resemblance and containment of
documents"). Every voter is as likely to be kept as any other: not the latest, not the first, not the one that drives
by most often, and nobody without the key can choose a name that gets in. A share of the voters of a street is the
same share of its slots, give or take its sampling: what floods the slots are names, not votes.

**Periods** have slots of their own, so that time enters: a road that changed is not shouted down by the years
before, and a crowd of today does not push out what was seen last week. Periods older than the last few are dropped.

What is kept of a union is what is kept of the union of what was kept, so that votes may be thinned as they arrive.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.map_update.fusion.votes import Integers, Votes, checked_secret, mixed


@dataclass(frozen=True, slots=True)
class Slots:
    """How much is kept of a surface: at most periods × voters × sessions votes."""

    period_days: int = 7
    periods: int = 8
    voters: int = 64
    sessions: int = 2
    """Of one voter, in one period."""


def kept(votes: Votes, secret: bytes, slots: Slots, *, newest_session: int) -> Votes:
    """Those of `votes` (n,), one of each key, that have a slot; in their order.

    `newest_session` is today: the period it is in and those before it, `slots.periods` in all, are kept. What claims
    to be of a later period is dropped too.
    """
    period = votes["session"] // slots.period_days
    newest = newest_session // slots.period_days
    recent = np.flatnonzero((period <= newest) & (period > newest - slots.periods))
    found, period = votes[recent], period[recent]
    key = np.frombuffer(
        hashlib.blake2b(b"slots", digest_size=16, key=checked_secret(secret)).digest(), np.uint64
    )
    voter_rank, session_rank = _ranks(
        found["surface_id"], period, found["voter"], found["session"], key[0], key[1]
    )
    order = np.lexsort((session_rank, found["voter"], voter_rank, period, found["surface_id"]))
    has_slot = np.zeros(len(found), bool)
    has_slot[order] = _chosen(
        found["surface_id"][order], period[order], found["voter"][order], slots.voters, slots.sessions
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
    of_voter, of_session = np.empty(len(voter), np.uint64), np.empty(len(voter), np.uint64)
    for i in range(len(voter)):
        place = mixed(voter_key ^ np.uint64(surface_id[i]))
        of_voter[i] = mixed(mixed(place ^ np.uint64(period[i])) ^ np.uint64(voter[i]))
        of_session[i] = mixed(mixed(session_key ^ of_voter[i]) ^ np.uint64(session[i]))
    return of_voter, of_session


@compiled
def _chosen(
    surface_id: Integers, period: Integers, voter: Integers, most_voters: int, most_sessions: int
) -> NDArray[np.bool_]:
    """Of rows in order of (surface, period, rank of the voter, rank of the session): the first of each."""
    chosen = np.zeros(len(voter), np.bool_)
    voters, sessions = 0, 0
    for i in range(len(voter)):
        if i == 0 or surface_id[i] != surface_id[i - 1] or period[i] != period[i - 1]:
            voters, sessions = 1, 1
        elif voter[i] != voter[i - 1]:
            voters, sessions = voters + 1, 1
        else:
            sessions += 1
        chosen[i] = voters <= most_voters and sessions <= most_sessions
    return chosen
