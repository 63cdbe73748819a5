"""Votes: the deviation from the reference that one vehicle observed on one road surface on one day.

A vote is a **summary that merges in any order**. Of the observations of one (surface, voter, session) it keeps the
SAMPLES with the lowest keyed hash, each a deviation from the reference with its σ; its value is their median. Keeping
the lowest ranks of a set is associative, commutative and idempotent: batches in any order, cut anywhere and repeated
give the same bytes. The median is robust against wrong-fix epochs, and only the holder of the key can predict which
observations count.

Neither a verdict nor a large deviation excludes an observation, or a changed road would censor itself. Excluded are
observations without a fixed solution, outside the surface they name, with too large a horizontal σ, without a finite
height, or of a surface that the reference does not have.

A **session** is a vehicle's day: mean solar time at the place, starting at 04:00, when traffic is lowest. It needs no
history of gaps between drives and limits each vehicle to one vote per surface and day. A vote keeps no finer time.
"""

from __future__ import annotations

import hashlib
import math

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_update.contribution import OBSERVATION, QUALITIES
from camber.road_map.height_interpolation import SurfaceHeights

Votes = NDArray[np.void]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SAMPLES = 5
"""Chosen: the errors of one pass over a surface of 20 m (one to two seconds) are strongly correlated, so more samples
add little; the median of five tolerates two outliers."""
NO_RANK = 2**31 - 1
"""Rank of an empty sample: the largest int32."""

KEY = ("surface_id", "voter", "session")
VOTE = np.dtype(
    [
        *((name, "<i8") for name in KEY),
        *((f"rank_{k}", "<i4") for k in range(SAMPLES)),
        *((f"deviation_{k}_m", "<f4") for k in range(SAMPLES)),
        *((f"sigma_{k}_m", "<f4") for k in range(SAMPLES)),
    ]
)
"""One vote; KEY identifies it. Samples are sorted by rank; empty ones have NO_RANK and zeros."""

_SAMPLES = np.dtype(
    [
        *((name, "<i8") for name in KEY),
        ("rank", "<i4", (SAMPLES,)),
        ("deviation_m", "<f4", (SAMPLES,)),
        ("sigma_m", "<f4", (SAMPLES,)),
    ]
)
"""The same bytes as VOTE with the samples as arrays."""
_SampleColumns = tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]
"""Rank, deviation and σ of samples, each (n, SAMPLES)."""

# Chosen: a session begins at 04:00 local solar time, when fewest drives are under way.
_SESSION_START_NS = 4 * 3_600 * 1_000_000_000
_FIXED = QUALITIES.index("fixed")
# Chosen: outside a surface its height is extrapolated with the slope at the edge, which holds for about a metre; at a
# larger σ the position says nothing about the lane.
_LARGEST_OUTSIDE_M = 1.0
_LARGEST_HORIZONTAL_SIGMA_M = 0.5
# Chosen: 128 bits, beyond exhaustive search; BLAKE2b (RFC 7693) takes keys of up to 64 bytes.
_LEAST_SECRET_BYTES = 16


def voter_of(vehicle: str, secret: bytes) -> int:
    """Return the pseudonym of a vehicle: 63 bits of keyed BLAKE2b (RFC 7693) of its name.

    Raises ValueError for a secret shorter than 16 bytes: names can be guessed, the key must not be.
    """
    check_secret(secret)
    digest = hashlib.blake2b(vehicle.encode(), digest_size=8, key=secret, person=b"camber voter").digest()
    return int.from_bytes(digest, "little") >> 1


def session_of(time_ns: Integers, longitude_rad: Floats) -> Integers:
    """Return the session (n,) of positioning times: days since the GPS epoch, in local mean solar time."""
    solar_ns = np.round(np.asarray(longitude_rad) / (2.0 * math.pi) * NS_PER_DAY).astype(np.int64)
    day: Integers = (np.asarray(time_ns) + solar_ns - _SESSION_START_NS) // NS_PER_DAY
    return day


def votes_from(
    observations: NDArray[np.void], voter: Integers | int, *, reference: SurfaceHeights, secret: bytes
) -> Votes:
    """Return the votes, sorted by key, of observations (n,) of OBSERVATION; `voter` is (n,) or one for all.

    `votes_from` of a whole equals `merge_votes` of its parts' votes, however it is cut and whatever is repeated.
    """
    check_secret(secret)
    if observations.dtype != OBSERVATION:
        raise ValueError("observations: expected rows of OBSERVATION")
    row = reference.rows_of(np.ascontiguousarray(observations["surface_id"]))
    usable = (row >= 0) & (observations["fix_quality"] == _FIXED)
    usable &= observations["horizontal_sigma_m"] <= _LARGEST_HORIZONTAL_SIGMA_M
    usable &= np.isfinite(observations["road_height_m"]) & (observations["road_height_sigma_m"] > 0.0)
    selected = observations[usable]
    reference_m, outside_m = reference.heights_m(
        row[usable],
        np.ascontiguousarray(selected["latitude_rad"]),
        np.ascontiguousarray(selected["longitude_rad"]),
    )
    inside = outside_m <= _LARGEST_OUTSIDE_M
    selected, reference_m = selected[inside], reference_m[inside]
    voters = np.broadcast_to(np.asarray(voter, np.int64), usable.shape)[usable][inside]
    samples = np.zeros(len(selected), _SAMPLES)
    samples["surface_id"], samples["voter"] = selected["surface_id"], voters
    samples["session"] = session_of(selected["time_ns"], selected["longitude_rad"])
    samples["rank"] = NO_RANK
    key = hashlib.blake2b(b"rank", digest_size=8, key=secret).digest()
    samples["rank"][:, 0] = _ranks(
        voters,
        selected["surface_id"],
        time_ns=selected["time_ns"],
        fix_id=selected["fix_id"],
        key=np.uint64(int.from_bytes(key, "little")),
    )
    samples["deviation_m"][:, 0] = selected["road_height_m"] - reference_m
    samples["sigma_m"][:, 0] = selected["road_height_sigma_m"]
    return _merge_samples(samples)


def merge_votes(*votes: Votes) -> Votes:
    """Return several sets of votes as one, sorted by key, each key once: associative, commutative, idempotent."""
    together = np.concatenate([np.zeros(0, VOTE), *votes]).astype(VOTE, copy=False)
    return _merge_samples(together.view(_SAMPLES))


def vote_values(votes: Votes) -> tuple[Floats, Floats, Floats]:
    """Return deviation (n,) and σ (n,) of each vote, medians of its samples, and the samples' variance (n,).

    The variance is NaN for fewer than three samples.
    """
    samples = votes.view(_SAMPLES)
    return _sample_medians(*_columns(samples))


def check_secret(secret: bytes) -> bytes:
    """Return the secret; raise ValueError if it is too short, or too long for BLAKE2b."""
    if not _LEAST_SECRET_BYTES <= len(secret) <= hashlib.blake2b.MAX_KEY_SIZE:
        raise ValueError(f"secret: {len(secret)} bytes, expected {_LEAST_SECRET_BYTES} to 64")
    return secret


def _merge_samples(samples: NDArray[np.void]) -> Votes:
    """Return samples sorted by key, those of one key merged into one vote."""
    samples = samples[np.lexsort(tuple(samples[name] for name in reversed(KEY)))]
    n = len(samples)
    first = np.ones(n, bool)
    first[1:] = np.logical_or.reduce([samples[name][1:] != samples[name][:-1] for name in KEY])
    merged = samples[first]
    if len(merged) < n:
        _keep_lowest(np.append(np.flatnonzero(first), n), _columns(samples), _columns(merged))
    votes: Votes = merged.view(VOTE)
    return votes


def _columns(samples: NDArray[np.void]) -> _SampleColumns:
    return samples["rank"], samples["deviation_m"], samples["sigma_m"]


@compiled
def _keep_lowest(begins: Integers, samples: _SampleColumns, merged: _SampleColumns) -> None:
    """Write the lowest SAMPLES different samples of rows `begins[i]` to `begins[i + 1]` into row i of `merged`.

    Samples are ordered by (rank, deviation, σ), so that observations of equal rank have a defined order.
    """
    rank, deviation_m, sigma_m = samples
    for i in range(len(begins) - 1):
        kept_rank, kept_deviation_m, kept_sigma_m = merged[0][i], merged[1][i], merged[2][i]
        count = 0
        for row in range(begins[i], begins[i + 1]):
            for k in range(SAMPLES):
                r, d, s = rank[row, k], deviation_m[row, k], sigma_m[row, k]
                if r == NO_RANK:
                    break
                at, known = count, False
                while at > 0:
                    q, e, t = kept_rank[at - 1], kept_deviation_m[at - 1], kept_sigma_m[at - 1]
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
                    kept_rank[j] = kept_rank[j - 1]
                    kept_deviation_m[j] = kept_deviation_m[j - 1]
                    kept_sigma_m[j] = kept_sigma_m[j - 1]
                kept_rank[at], kept_deviation_m[at], kept_sigma_m[at] = r, d, s
        kept_rank[count:] = NO_RANK
        kept_deviation_m[count:] = 0.0
        kept_sigma_m[count:] = 0.0


@compiled
def _sample_medians(
    rank: NDArray[np.int32], deviation_m: NDArray[np.float32], sigma_m: NDArray[np.float32]
) -> tuple[Floats, Floats, Floats]:
    n = len(rank)
    median_m, median_sigma_m, variance_m2 = np.empty(n), np.empty(n), np.full(n, np.nan)
    for i in range(n):
        count = 0
        while count < SAMPLES and rank[i, count] != NO_RANK:
            count += 1
        values = np.sort(deviation_m[i, :count].astype(np.float64))
        median_m[i] = np.median(values)
        median_sigma_m[i] = np.median(sigma_m[i, :count].astype(np.float64))
        if count >= 3:
            variance_m2[i] = np.var(values) * count / (count - 1)
    return median_m, median_sigma_m, variance_m2


@compiled
def splitmix64(number: np.uint64) -> np.uint64:
    """Apply SplitMix64's finaliser (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators")."""
    number = (number ^ (number >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    number = (number ^ (number >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return number ^ (number >> np.uint64(31))


@compiled
def _ranks(
    voter: Integers, surface_id: Integers, time_ns: Integers, fix_id: Integers, key: np.uint64
) -> NDArray[np.int32]:
    """Return the ranks (n,) of observations, 0 to 2³¹ − 2, which only the holder of the key can predict."""
    rank = np.empty(len(voter), np.int32)
    for i in range(len(voter)):
        state = splitmix64(key ^ np.uint64(voter[i]))
        state = splitmix64(state ^ np.uint64(surface_id[i]))
        state = splitmix64(state ^ np.uint64(time_ns[i]))
        state = splitmix64(state ^ np.uint64(fix_id[i]))
        rank[i] = np.int32(min(state >> np.uint64(33), np.uint64(NO_RANK - 1)))
    return rank
