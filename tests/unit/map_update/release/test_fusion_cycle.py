"""Uploads in a store become votes once, and a release with the road as the fleet observed it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

from camber.map_update.contribution import OBSERVATION, QUALITIES, Contribution
from camber.map_update.fusion.pipeline import Fusion
from camber.map_update.release.fusion_cycle import FusionCycle, FusionDecision, IngestResult
from camber.map_update.release.operator_decisions import decide, roll_back
from camber.map_update.release.release_builder import ReleaseBuilder
from camber.map_update.release.review import ReviewFolder
from camber.map_update.stores.sqlite_store import SqliteStore
from camber.map_update.stores.store import OvertakenError, Store
from camber.road_map.release import open_release, read_release
from camber.schemas.fleet import MapDecision
from support.contributions import committed
from support.small_map import DAY_NS, MADE_NS, at, link, surface, write

SURFACES = 60
CHANGED = range(20, 24)
"""Of a road of 1,200 m these four pieces are 8 cm higher than at the survey."""
SECRET = bytes(range(32))
NOW_NS = MADE_NS + 6 * DAY_NS


def drive(vehicle: int, day: int, *, raised_m: float = 0.08, datum: str = "WGS84") -> Contribution:
    """All pieces twice in one batch; each vehicle has its bias, each observation its noise."""
    rng = np.random.default_rng([vehicle, day])
    piece = np.repeat(np.arange(SURFACES), 2)
    rows = np.zeros(len(piece), OBSERVATION)
    rows["time_ns"] = MADE_NS + day * DAY_NS + vehicle * 10**9 + np.arange(len(rows)) * 10**8
    rows["fix_id"] = rows["time_ns"] // 10**6
    rows["fix_quality"] = QUALITIES.index("fixed")
    rows["surface_id"] = piece
    places = [at(20.0 * k, 0.3) for k in piece.tolist()]
    rows["latitude_rad"], rows["longitude_rad"] = np.array(places).T
    rows["horizontal_sigma_m"], rows["road_height_sigma_m"] = 0.02, 0.02
    bias_m = 0.02 * np.random.default_rng(vehicle).standard_normal()
    rows["road_height_m"] = 50.0 + bias_m + 0.005 * rng.standard_normal(len(rows))
    rows["road_height_m"][np.isin(piece, CHANGED)] += raised_m
    rows["antenna_height_m"] = 1.6
    return Contribution(
        vehicle=f"car{vehicle}",
        kind="batch",
        id=f"{day}",
        datum=datum,
        map_version=7,
        epoch_year=2024.0,
        position_covariance_enu_m2=None,
        observations=rows,
    )


def fleet() -> list[Contribution]:
    return [drive(vehicle, day) for day in (1, 3, 5) for vehicle in range(12)]


def fusion_cycle(
    folder: Path, store: Store, *, every_s: float = 60.0, most_records: int = 200_000
) -> FusionCycle:
    if not (folder / "in").exists():
        rows = [surface(k, 20.0 * k, link_id=k // 10) for k in range(SURFACES)]
        roads = [
            link(k, (k, k + 1), [(200.0 * k - 10.0, 0.0), (200.0 * k + 190.0, 0.0)])
            for k in range(SURFACES // 10)
        ]
        write(folder / "in", rows, roads)
    reference = open_release(folder / "in")
    fusion = Fusion(reference.road_surfaces(), SECRET)
    builder = ReleaseBuilder(folder / "out", reference, signing_key=None)
    return FusionCycle(store, fusion, builder, every_s=every_s, most_records=most_records)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return SqliteStore(tmp_path / "uploads.sqlite")


def all_steps(cycle: FusionCycle, now_ns: int) -> FusionDecision:
    while isinstance(result := cycle.step(now_ns), IngestResult):
        pass
    assert result is not None
    return result


def raised_m(folder: Path) -> np.ndarray:
    return np.array([grid.mean() - 50.0 for grid in read_release(folder / "out").road_surfaces().heights_m])


def test_a_changed_road_is_published_and_unchanged_roads_stay(tmp_path: Path, store: Store) -> None:
    committed(store, *fleet())
    result = all_steps(fusion_cycle(tmp_path, store), NOW_NS)
    offset_m = raised_m(tmp_path)
    assert result.is_new
    assert offset_m[CHANGED] == pytest.approx([0.08] * 4, abs=0.02)
    assert np.abs(np.delete(offset_m, CHANGED)).max() == 0.0
    assert set(result.decisions.of("publish")["surface_id"]) == set(CHANGED)


def test_changes_for_viewers_are_those_that_were_published(tmp_path: Path, store: Store) -> None:
    committed(store, *fleet())
    cycle = fusion_cycle(tmp_path, store)
    decided = all_steps(cycle, NOW_NS)
    changes = cycle.changes(decided, NOW_NS)
    assert changes.published is not None
    assert sorted(changes.published.surface_id.tolist()) == list(CHANGED)
    assert changes.published.offset_m == pytest.approx([0.08] * 4, abs=0.02)
    assert changes.map_version == decided.root.map_version


def changed_row(field: str, value: float, **header: object) -> Contribution:
    """A drive whose record 5 has another value."""
    contribution = drive(1, 1)
    contribution.observations[field][5] = value
    return replace(contribution, **header)


def elsewhere() -> np.ndarray:
    """Observations on the other side of the earth, of a surface that is not known."""
    rows = drive(1, 1).observations
    rows["surface_id"], rows["longitude_rad"] = 99, rows["longitude_rad"] - math.pi
    return rows


def in_feet() -> Contribution:
    contribution = drive(1, 1)
    contribution.observations["road_height_m"] /= 0.3048
    return contribution


def raised_by(offset_m: float) -> Contribution:
    contribution = drive(1, 1)
    contribution.observations["road_height_m"] += offset_m
    return contribution


@pytest.mark.parametrize(
    ("contribution", "code"),
    [
        (drive(1, 1), None),
        (changed_row("surface_id", 99), "unknown_surface"),
        (changed_row("surface_id", 99, map_version=6), None),  # its map may have other surfaces
        (changed_row("surface_id", 99, map_version=12), None),
        (changed_row("latitude_rad", 0.61), "far_from_surface"),
        (
            replace(changed_row("surface_id", 99), observations=elsewhere()),
            None,
        ),  # another region, its version 7
        (changed_row("road_height_m", 50.0 / 0.3048), None),  # one of many, for the fusion to find out
        (in_feet(), "height_in_feet"),
        (raised_by(65.0), None),  # the reference may be wrong
    ],
)
def test_rows_that_cannot_be_of_their_road_are_refused(
    contribution: Contribution, code: str | None, tmp_path: Path, store: Store
) -> None:
    refusal = fusion_cycle(tmp_path, store).refusal(contribution)
    assert (None if refusal is None else refusal.code) == code
    assert refusal is None or refusal.text.startswith(("record 5: ", "record 0: road_height_m"))


def test_surfaces_are_those_of_releases_that_were_made_since(tmp_path: Path, store: Store) -> None:
    committed(store, *fleet())
    cycle = fusion_cycle(tmp_path, store)
    version = all_steps(cycle, NOW_NS).root.map_version
    contribution = changed_row("surface_id", 99, map_version=version)
    for each in (cycle, fusion_cycle(tmp_path, store)):  # the second after a restart
        refusal = each.refusal(contribution)
        assert refusal is not None
        assert refusal.code == "unknown_surface"


def test_the_first_release_is_the_reference(tmp_path: Path, store: Store) -> None:
    result = all_steps(fusion_cycle(tmp_path, store), NOW_NS)
    assert result.is_new
    assert np.abs(raised_m(tmp_path)).max() == 0.0


def test_without_new_votes_there_is_no_new_release(tmp_path: Path, store: Store) -> None:
    committed(store, *fleet())
    cycle = fusion_cycle(tmp_path, store, every_s=60.0)
    first = all_steps(cycle, NOW_NS)
    assert cycle.step(NOW_NS + 59 * 10**9) is None  # not due
    assert cycle.step(NOW_NS + 61 * 10**9) is None  # nothing has come
    again = all_steps(fusion_cycle(tmp_path, store), NOW_NS + 10**9)  # as after a restart
    assert (again.is_new, again.root) == (False, first.root)


def test_the_release_does_not_depend_on_the_division_into_steps(tmp_path: Path, store: Store) -> None:
    committed(store, *fleet())
    (tmp_path / "whole").mkdir()
    (tmp_path / "cut").mkdir()
    all_steps(fusion_cycle(tmp_path / "whole", store), NOW_NS)
    other = SqliteStore(tmp_path / "cut" / "uploads.sqlite")
    for contribution in reversed(fleet()):
        committed(other, contribution)
    # A process of its own for each step, as if each had been killed after it.
    while isinstance(fusion_cycle(tmp_path / "cut", other, most_records=100).step(NOW_NS), IngestResult):
        pass
    assert raised_m(tmp_path / "cut").tolist() == raised_m(tmp_path / "whole").tolist()
    assert other.progress().cursor == len(fleet())


def test_an_overtaken_step_writes_nothing(tmp_path: Path, store: Store) -> None:
    committed(store, *fleet())
    quick = fusion_cycle(tmp_path, store)

    class Overtaking(SqliteStore):
        def observations_after(self, cursor: int, limit: int):  # type: ignore[no-untyped-def]
            page = super().observations_after(cursor, limit)
            quick.step(NOW_NS)
            return page

    slow = fusion_cycle(tmp_path, Overtaking(tmp_path / "uploads.sqlite"))
    with pytest.raises(OvertakenError):
        slow.step(NOW_NS)
    votes = store.votes_of()
    assert len(votes) == SURFACES * 36
    assert store.progress().cursor == len(fleet())


def test_observations_of_another_datum_are_stored_but_not_fused(tmp_path: Path, store: Store) -> None:
    committed(store, drive(1, 1), drive(2, 1, datum="JGD2011"), drive(3, 1, datum="ITRF2020"))
    result = fusion_cycle(tmp_path, store).step(NOW_NS)
    assert isinstance(result, IngestResult)
    assert (result.contributions, result.observations, result.other_datum) == (3, 360, 120)
    assert len(np.unique(store.votes_of()["voter"])) == 2


def test_a_clock_set_back_does_not_stop_the_fusion(tmp_path: Path, store: Store) -> None:
    cycle = fusion_cycle(tmp_path, store, every_s=60.0)
    all_steps(cycle, NOW_NS)
    committed(store, *fleet())
    assert isinstance(cycle.step(NOW_NS - DAY_NS // 24), IngestResult)


def test_a_road_lowered_again_equals_the_reference(tmp_path: Path, store: Store) -> None:
    committed(store, *fleet())
    all_steps(fusion_cycle(tmp_path, store), NOW_NS)
    later = [drive(vehicle, day, raised_m=0.0) for day in range(20, 40, 3) for vehicle in range(12)]
    committed(store, *later)
    result = all_steps(fusion_cycle(tmp_path, store), MADE_NS + 40 * DAY_NS)
    assert result.is_new
    assert np.abs(raised_m(tmp_path)).max() <= 0.01


def test_the_next_cycle_applies_accepted_changes_and_roll_backs(tmp_path: Path, store: Store) -> None:
    higher = [drive(vehicle, day, raised_m=0.7) for day in (1, 3, 5) for vehicle in range(12)]
    committed(store, *higher)
    cycle = fusion_cycle(tmp_path, store, every_s=1.0)
    all_steps(cycle, NOW_NS)
    review = ReviewFolder(tmp_path / "out")
    assert {held.surface_id for held in review.held()} == set(CHANGED)  # larger than a road is resurfaced
    by: Any = {"who": "ann", "why": "a new bridge", "time_ns": NOW_NS}
    by["reference_sha256"] = open_release(tmp_path / "in").root.manifest_sha256
    decide(
        review,
        [
            MapDecision(action="accept", surface_id=held.surface_id, offset_m=held.offset_m, **by)
            for held in review.held()
        ],
        now_ns=NOW_NS,
    )
    published = cycle.step(NOW_NS + 2 * 10**9)
    assert isinstance(published, FusionDecision)
    assert raised_m(tmp_path)[CHANGED] == pytest.approx([0.7] * 4, abs=0.03)
    assert review.held() == []

    builder = ReleaseBuilder(tmp_path / "out", open_release(tmp_path / "in"), signing_key=None)
    back = MapDecision(action="roll_back", map_version=published.root.map_version - 1, **by)
    assert roll_back(review, back, builder, time_ns=NOW_NS + 3 * 10**9).withdrawn == len(CHANGED)
    again = cycle.step(NOW_NS + 5 * 10**9)
    assert isinstance(again, FusionDecision)
    assert again.root.map_version == published.root.map_version + 1
    assert np.abs(raised_m(tmp_path)).max() == 0.0


def held_and_by(folder: Path, store: Store) -> tuple[FusionCycle, dict[str, Any]]:
    """A cycle with four changes that are held, and what decisions have in common."""
    committed(store, *[drive(vehicle, day, raised_m=0.7) for day in (1, 3, 5) for vehicle in range(12)])
    cycle = fusion_cycle(folder, store, every_s=1.0)
    all_steps(cycle, NOW_NS)
    digest = open_release(folder / "in").root.manifest_sha256
    return cycle, {"who": "ann", "why": "a new bridge", "time_ns": NOW_NS, "reference_sha256": digest}


def accepted(folder: Path, by: dict[str, Any]) -> list[MapDecision]:
    return [
        MapDecision(action="accept", surface_id=held.surface_id, offset_m=held.offset_m, **by)
        for held in ReviewFolder(folder / "out").held()
    ]


def test_going_back_while_the_fusion_decides_is_not_undone(
    tmp_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    cycle, by = held_and_by(tmp_path, store)
    review = ReviewFolder(tmp_path / "out")
    decide(review, accepted(tmp_path, by), now_ns=NOW_NS)
    cycle.step(NOW_NS + 2 * 10**9)
    builder = ReleaseBuilder(tmp_path / "out", open_release(tmp_path / "in"), signing_key=None)
    back = MapDecision(action="roll_back", map_version=8, **by)
    fusion_decide = Fusion.decide

    def meanwhile(*given: Any) -> Any:
        monkeypatch.setattr(Fusion, "decide", fusion_decide)
        roll_back(review, back, builder, time_ns=NOW_NS)
        return fusion_decide(*given)

    monkeypatch.setattr(Fusion, "decide", meanwhile)
    committed(store, drive(3, 5, raised_m=0.7), drive(12, 5, raised_m=0.7))
    with pytest.raises(OvertakenError, match="another release"):
        all_steps(cycle, NOW_NS + 4 * 10**9)
    all_steps(cycle, NOW_NS + 9 * 10**9)
    assert np.abs(raised_m(tmp_path)).max() == 0.0


def test_a_decision_recorded_during_a_cycle_is_applied_in_the_next(
    tmp_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    cycle, by = held_and_by(tmp_path, store)
    decisions, build = accepted(tmp_path, by), ReleaseBuilder.build
    deciding = Thread(
        target=decide, args=(ReviewFolder(tmp_path / "out"), decisions), kwargs={"now_ns": NOW_NS}
    )

    def meanwhile(*given: Any, **named: Any) -> Any:
        deciding.start()
        deciding.join(0.5)
        return build(*given, **named)

    with monkeypatch.context() as patched:
        patched.setattr(ReleaseBuilder, "build", meanwhile)
        cycle.decide(NOW_NS)
    deciding.join()
    assert isinstance(cycle.step(NOW_NS + 2 * 10**9), FusionDecision)
    assert raised_m(tmp_path)[CHANGED] == pytest.approx([0.7] * 4, abs=0.03)
