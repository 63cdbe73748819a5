"""Votes: what one vehicle said of one road surface on one of its days.

A vote is a **summary that merges in any order**. Of the observations of a surface, a voter and a session it keeps the
SAMPLES that a keyed hash ranks lowest, each a deviation from the reference with its σ, and its value is their median.
Keeping the lowest ranks of a set is associative, commutative and idempotent, so that votes made of batches which came
in any order, cut anywhere, and more than once, are the same bytes as those made of all at once. It is robust too:
wrong-fix epochs that are fewer than half of a session's observations do not carry its median, and nobody without the
key can choose which of their observations count.

Nothing is left out for what it says: neither a verdict nor a large deviation keeps an observation out, or a change
of the road would censor itself. Left out is what is of no use whatever it says: no fixed solution, a place beside the
surface it names or known too badly to say, a height without a number, a surface that the reference does not have.

A **session** is a vehicle's day: days of mean solar time at the place, which begin at four in the morning when roads
are emptiest. It needs no history of the vehicle's gaps, which come late and out of order, and binds how often a
vehicle can speak: once per surface and day, however often it passes. Of the time of passing a vote keeps no more.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.map_update.contribution import OBSERVATION, QUALITIES

Votes = NDArray[np.void]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SAMPLES = 5
"""A pass over a surface of 20 m takes a second or two: its errors are one draw of the slow ones, and more would say
no more. Two of five may be wrong."""
NO_RANK = 2**31 - 1
"""The rank of a sample that is not there."""

VOTE = np.dtype(
    [
        ("surface_id", "<i8"),
        ("voter", "<i8"),
        ("session", "<i8"),
        *((f"rank_{k}", "<i4") for k in range(SAMPLES)),
        *((f"deviation_{k}_m", "<f4") for k in range(SAMPLES)),
        *((f"sigma_{k}_m", "<f4") for k in range(SAMPLES)),
    ]
)
"""One vote; (surface_id, voter, session) is its key. Samples ascend by rank; one not there has NO_RANK and zeros."""

KEY = ("surface_id", "voter", "session")
_SAMPLES = np.dtype(
    [
        *((name, "<i8") for name in KEY),
        ("rank", "<i4", (SAMPLES,)),
        ("deviation_m", "<f4", (SAMPLES,)),
        ("sigma_m", "<f4", (SAMPLES,)),
    ]
)
"""The same bytes with the samples as arrays."""

DAY_NS = 86_400 * 1_000_000_000
_DAY_BEGINS_NS = 4 * 3_600 * 1_000_000_000
_FIXED = QUALITIES.index("fixed")
_SECRET_BYTES = 16


class Reference(Protocol):
    """Heights of the reference release; `camber.road_map.surface_heights.SurfaceHeights` is one."""

    def rows_of(self, surface_id: Integers, /) -> Integers:
        """Rows (n,) of surfaces by their ids (n,), −1 where there is none."""

    def heights_m(
        self, row: Integers, latitude_rad: Floats, longitude_rad: Floats, /
    ) -> tuple[Floats, Floats]:
        """Height (n,) at places on surfaces, and how far (n,) each is outside its surface's rectangle."""


@dataclass(frozen=True, slots=True)
class Gate:
    """Which observations are of use, whatever they say.

    Beside a surface its height goes on with the slope at its edge, which a metre away is still that of the road.
    """

    largest_outside_m: float = 1.0
    largest_horizontal_sigma_m: float = 0.5


def voter_of(vehicle: str, secret: bytes) -> int:
    """The pseudonym of a vehicle: 63 bits of keyed BLAKE2b (RFC 7693) of its name.

    Raises ValueError for a secret shorter than 16 bytes: names can be guessed, the key must not be.
    """
    checked_secret(secret)
    digest = hashlib.blake2b(vehicle.encode(), digest_size=8, key=secret, person=b"camber voter").digest()
    return int.from_bytes(digest, "little") >> 1


def session_of(time_ns: Integers, longitude_rad: Floats) -> Integers:
    """The day (n,) of positioning times, counted from the GPS epoch, in mean solar time of the place."""
    solar_ns = np.round(np.asarray(longitude_rad) / (2.0 * math.pi) * DAY_NS).astype(np.int64)
    day: Integers = (np.asarray(time_ns) + solar_ns - _DAY_BEGINS_NS) // DAY_NS
    return day


def votes_from(
    observations: NDArray[np.void],
    voter: Integers | int,
    reference: Reference,
    secret: bytes,
    gate: Gate | None = None,
) -> Votes:
    """Votes, in the order of their keys, of observations (n,) of OBSERVATION whose voters are `voter` (n,) or one.

    `votes_from` of a whole is `merged` of its parts' votes, however it is cut and whatever is in several parts.
    """
    checked_secret(secret)
    if observations.dtype != OBSERVATION:
        raise ValueError("observations: expected rows of OBSERVATION")
    gate = gate or Gate()
    row = reference.rows_of(np.ascontiguousarray(observations["surface_id"]))
    of_use = (row >= 0) & (observations["fix_quality"] == _FIXED)
    of_use &= observations["horizontal_sigma_m"] <= gate.largest_horizontal_sigma_m
    of_use &= np.isfinite(observations["road_height_m"]) & (observations["road_height_sigma_m"] > 0.0)
    found = observations[of_use]
    reference_m, outside_m = reference.heights_m(
        row[of_use],
        np.ascontiguousarray(found["latitude_rad"]),
        np.ascontiguousarray(found["longitude_rad"]),
    )
    inside = outside_m <= gate.largest_outside_m
    found, reference_m = found[inside], reference_m[inside]
    voters = np.broadcast_to(np.asarray(voter, np.int64), of_use.shape)[of_use][inside]
    single = np.zeros(len(found), _SAMPLES)
    single["surface_id"], single["voter"] = found["surface_id"], voters
    single["session"] = session_of(found["time_ns"], found["longitude_rad"])
    single["rank"] = NO_RANK
    single["rank"][:, 0] = _ranks(
        voters, found["surface_id"], found["time_ns"], found["fix_id"], np.uint64(_number(secret, b"rank"))
    )
    single["deviation_m"][:, 0] = found["road_height_m"] - reference_m
    single["sigma_m"][:, 0] = found["road_height_sigma_m"]
    return _of_any_order(single)


def merged(*votes: Votes) -> Votes:
    """The votes of several sets as one set, in the order of their keys; each key once.

    Associative, commutative and idempotent, bit for bit.
    """
    together = np.concatenate([np.zeros(0, VOTE), *votes]).astype(VOTE, copy=False)
    return _of_any_order(together.view(_SAMPLES))


def values_of(votes: Votes) -> tuple[Floats, Floats, Floats]:
    """Deviation from the reference (n,) and σ (n,) of each vote, medians of its samples, and their variance (n,).

    The variance is NaN where there are fewer than three.
    """
    samples = votes.view(_SAMPLES)
    return _medians(samples["rank"], samples["deviation_m"], samples["sigma_m"])


def checked_secret(secret: bytes) -> bytes:
    """The secret itself; ValueError where it is too short to be one, or too long for BLAKE2b."""
    if not _SECRET_BYTES <= len(secret) <= hashlib.blake2b.MAX_KEY_SIZE:
        raise ValueError(f"secret: {len(secret)} bytes, expected {_SECRET_BYTES} to 64")
    return secret


def _number(secret: bytes, purpose: bytes) -> int:
    """A key of 64 bits of its own for each purpose."""
    return int.from_bytes(hashlib.blake2b(purpose, digest_size=8, key=secret).digest(), "little")


def _of_any_order(samples: NDArray[np.void]) -> Votes:
    """Sorted by key, those of one key as one."""
    order = np.lexsort(tuple(samples[name] for name in reversed(KEY)))
    samples = samples[order]
    n = len(samples)
    first = np.ones(n, bool)
    for k, name in enumerate(KEY):
        changes = samples[name][1:] != samples[name][:-1]
        first[1:] = changes if k == 0 else first[1:] | changes
    result = samples[first]
    if len(result) < n:
        begins = np.append(np.flatnonzero(first), n)
        rank, deviation_m, sigma_m = (result[name] for name in ("rank", "deviation_m", "sigma_m"))
        _keep_lowest(
            begins, samples["rank"], samples["deviation_m"], samples["sigma_m"], rank, deviation_m, sigma_m
        )
    votes: Votes = result.view(VOTE)
    return votes


@compiled
def _keep_lowest(
    begins: Integers,
    rank: NDArray[np.int32],
    deviation_m: NDArray[np.float32],
    sigma_m: NDArray[np.float32],
    kept_rank: NDArray[np.int32],
    kept_deviation_m: NDArray[np.float32],
    kept_sigma_m: NDArray[np.float32],
) -> None:
    """Of rows `begins[i]` to `begins[i + 1]` the lowest SAMPLES different samples, into row i.

    Samples are in order of (rank, deviation, σ), so that two observations of one rank have an order too.
    """
    for i in range(len(begins) - 1):
        count = 0
        for row in range(begins[i], begins[i + 1]):
            for k in range(SAMPLES):
                r, d, s = rank[row, k], deviation_m[row, k], sigma_m[row, k]
                if r == NO_RANK:
                    break
                at, known = count, False
                while at > 0:
                    q, e, t = kept_rank[i, at - 1], kept_deviation_m[i, at - 1], kept_sigma_m[i, at - 1]
                    if q == r and e == d and t == s:
                        known = True
                        break
                    if q < r or (q == r and (e < d or (e == d and t < s))):
                        break
                    at -= 1
                if known or at == SAMPLES:
                    continue
                count = min(count + 1, SAMPLES)
                for j in range(count - 1, at, -1):
                    kept_rank[i, j] = kept_rank[i, j - 1]
                    kept_deviation_m[i, j] = kept_deviation_m[i, j - 1]
                    kept_sigma_m[i, j] = kept_sigma_m[i, j - 1]
                kept_rank[i, at], kept_deviation_m[i, at], kept_sigma_m[i, at] = r, d, s
        for k in range(count, SAMPLES):
            kept_rank[i, k] = NO_RANK
            kept_deviation_m[i, k] = 0.0
            kept_sigma_m[i, k] = 0.0


@compiled
def _medians(
    rank: NDArray[np.int32], deviation_m: NDArray[np.float32], sigma_m: NDArray[np.float32]
) -> tuple[Floats, Floats, Floats]:
    n = len(rank)
    middle_m, middle_sigma_m, variance_m2 = np.empty(n), np.empty(n), np.full(n, np.nan)
    value, sigma = np.empty(SAMPLES), np.empty(SAMPLES)
    for i in range(n):
        count = 0
        while count < SAMPLES and rank[i, count] != NO_RANK:
            d, s = np.float64(deviation_m[i, count]), np.float64(sigma_m[i, count])
            at = count
            while at > 0 and value[at - 1] > d:
                value[at] = value[at - 1]
                at -= 1
            value[at] = d
            at = count
            while at > 0 and sigma[at - 1] > s:
                sigma[at] = sigma[at - 1]
                at -= 1
            sigma[at] = s
            count += 1
        half = count // 2
        if count % 2 == 1:
            middle_m[i], middle_sigma_m[i] = value[half], sigma[half]
        else:
            middle_m[i] = 0.5 * (value[half - 1] + value[half])
            middle_sigma_m[i] = 0.5 * (sigma[half - 1] + sigma[half])
        if count >= 3:
            variance_m2[i] = np.var(value[:count]) * count / (count - 1)
    return middle_m, middle_sigma_m, variance_m2


@compiled
def mixed(number: np.uint64) -> np.uint64:
    """SplitMix64's finaliser (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators")."""
    number = (number ^ (number >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    number = (number ^ (number >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return number ^ (number >> np.uint64(31))


@compiled
def _ranks(
    voter: Integers, surface_id: Integers, time_ns: Integers, fix_id: Integers, key: np.uint64
) -> NDArray[np.int32]:
    """Ranks (n,) of observations, 0 to 2³¹ − 2, that only who has the key can foresee."""
    rank = np.empty(len(voter), np.int32)
    for i in range(len(voter)):
        state = mixed(key ^ np.uint64(voter[i]))
        state = mixed(state ^ np.uint64(surface_id[i]))
        state = mixed(state ^ np.uint64(time_ns[i]))
        state = mixed(state ^ np.uint64(fix_id[i]))
        rank[i] = np.int32(min(state >> np.uint64(33), np.uint64(NO_RANK - 1)))
    return rank
