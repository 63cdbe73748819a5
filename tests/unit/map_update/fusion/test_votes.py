"""Votes: the same from batches in any order, cut anywhere and more than once; robust within a session."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_update.contribution import OBSERVATION, QUALITIES, VERDICTS
from camber.map_update.fusion.votes import (
    KEY,
    NO_RANK,
    SAMPLES,
    Votes,
    merge_votes,
    session_of,
    vote_values,
    voter_of,
    votes_from,
)
from camber.road_map.height_interpolation import SurfaceHeights

SECRET = b"sixteen bytes at least"
BEGIN_NS = 1_000_000 * NS_PER_DAY // 1000


class Flat(SurfaceHeights):
    """A reference of fifty surfaces, each 100 m high and flat; a latitude is how far outside a place is."""

    def __init__(self) -> None:
        """Has no surfaces to read."""

    def rows_of(self, surface_id: Any) -> NDArray[np.int64]:
        return np.where(surface_id < 50, surface_id, -1)

    def heights_m(self, row: Any, latitude_rad: Any, longitude_rad: Any) -> tuple[Any, Any]:
        return np.full(len(row), 100.0), latitude_rad


def observed(heights_m: list[float] | NDArray[np.float64], surface: int = 7) -> NDArray[np.void]:
    rows = np.zeros(len(heights_m), OBSERVATION)
    rows["time_ns"] = BEGIN_NS + np.arange(len(rows)) * 200_000_000
    rows["fix_id"] = np.arange(len(rows))
    rows["fix_quality"] = QUALITIES.index("fixed")
    rows["surface_id"] = surface
    rows["road_height_m"] = heights_m
    rows["road_height_sigma_m"] = 0.02
    return rows


def many(seed: int, n: int = 600) -> tuple[NDArray[np.void], NDArray[np.int64]]:
    rng = np.random.default_rng(seed)
    rows = observed(100.0 + rng.normal(0.0, 0.1, n))
    rows["surface_id"] = rng.integers(0, 12, n)
    rows["time_ns"] = BEGIN_NS + rng.integers(0, 3 * NS_PER_DAY, n)
    return rows, rng.integers(1, 5, n)


def votes(rows: NDArray[np.void], voter: NDArray[np.int64] | int = 1) -> Votes:
    return votes_from(rows, voter, reference=Flat(), secret=SECRET)


@pytest.mark.parametrize("seed", range(5))
def test_batches_in_any_order_cut_anywhere_and_repeated_make_the_same_votes(seed: int) -> None:
    rows, voter = many(seed)
    whole = votes(rows, voter)
    rng = np.random.default_rng(seed + 100)
    parts = []
    for _ in range(8):  # overlapping, and all of them together
        some = rng.permutation(len(rows))[: rng.integers(1, len(rows))]
        parts.append(votes(rows[some], voter[some]))
    rest = rng.permutation(len(rows))
    parts += [votes(rows[rest[k::3]], voter[rest[k::3]]) for k in range(3)]
    assert merge_votes(*parts).tobytes() == whole.tobytes()
    a, b, c = parts[0], parts[5], parts[9]
    assert merge_votes(a, b).tobytes() == merge_votes(b, a).tobytes()
    assert merge_votes(merge_votes(a, b), c).tobytes() == merge_votes(a, merge_votes(b, c)).tobytes()
    assert merge_votes(whole, whole).tobytes() == whole.tobytes() == merge_votes(whole, a).tobytes()


def test_one_vote_for_each_surface_voter_and_day() -> None:
    rows, voter = many(1)
    result = votes(rows, voter)
    session = session_of(rows["time_ns"], rows["longitude_rad"])
    expected = np.unique(np.column_stack((rows["surface_id"], voter, session)), axis=0)
    assert np.array_equal(np.column_stack([result[name] for name in KEY]), expected)


def test_two_wrong_fixes_of_five_do_not_move_the_vote() -> None:
    value_m, sigma_m, _ = vote_values(votes(observed([100.03, 100.01, 100.8, 100.02, 101.5])))
    assert value_m == pytest.approx([0.03], abs=1e-4)
    assert sigma_m == pytest.approx([0.02])


def test_the_secret_selects_the_few_observations_that_count() -> None:
    rows = observed(100.0 + np.arange(40) / 100.0)
    one = votes(rows)
    other = votes_from(rows, 1, reference=Flat(), secret=b"another secret of bytes")
    assert (one["rank_4"] != NO_RANK).all()
    ranks = [int(one[f"rank_{k}"][0]) for k in range(SAMPLES)]
    assert ranks == sorted(ranks)
    assert vote_values(one)[0] != vote_values(other)[0]


def test_neither_verdict_nor_deviation_excludes_an_observation() -> None:
    rows = observed([100.3, 100.3, 104.0])
    rows["verdict"] = VERDICTS.index("erroneous")
    value_m, _, variance_m2 = vote_values(votes(rows))
    assert value_m == pytest.approx([0.3], abs=1e-4)
    assert variance_m2[0] > 1.0


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("fix_quality", QUALITIES.index("float")),
        ("surface_id", 99),
        ("latitude_rad", 1.5),
        ("latitude_rad", np.nan),
        ("horizontal_sigma_m", 0.6),
        ("horizontal_sigma_m", np.nan),
        ("road_height_m", np.nan),
        ("road_height_m", np.inf),
        ("road_height_sigma_m", 0.0),
        ("road_height_sigma_m", np.nan),
    ],
)
def test_unusable_observations_are_excluded(field: str, value: float) -> None:
    rows = observed([100.1, 100.2])
    rows[field][0] = value
    value_m, _, _ = vote_values(votes(rows))
    assert value_m == pytest.approx([0.2], abs=1e-4)


def test_a_session_begins_at_four_in_local_solar_time() -> None:
    # GPS time began at midnight in Greenwich: four o'clock there, five hours earlier further east.
    four_ns = np.array([4 * 3600 * 10**9, 4 * 3600 * 10**9 - 1])
    assert session_of(four_ns, np.zeros(2)).tolist() == [0, -1]
    assert session_of(four_ns - 5 * 3600 * 10**9, np.full(2, 5 * np.pi / 12)).tolist() == [0, -1]


def test_a_voter_is_a_pseudonym_that_needs_the_secret() -> None:
    assert voter_of("car-1", SECRET) == voter_of("car-1", SECRET)
    assert voter_of("car-1", SECRET) != voter_of("car-2", SECRET)
    assert voter_of("car-1", SECRET) != voter_of("car-1", b"another secret of bytes")
    assert 0 <= voter_of("car-1", SECRET) < 2**63
    for secret in (b"too short", b"x" * 65):
        with pytest.raises(ValueError, match="expected 16 to 64"):
            voter_of("car-1", secret)


def test_no_observations_give_no_votes_and_other_rows_are_refused() -> None:
    assert len(votes(observed([]))) == 0 == len(merge_votes())
    with pytest.raises(ValueError, match="expected rows of OBSERVATION"):
        votes(np.zeros(3, [("time_ns", "<i8")]))
