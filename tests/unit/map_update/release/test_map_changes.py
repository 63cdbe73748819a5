"""Changes for viewers: places of surfaces and regions, the largest held and the newest published first."""

from __future__ import annotations

from datetime import date, timedelta
from pathlib import Path

import numpy as np
import pytest

from camber.map_update.fusion.correction_rows import CORRECTION
from camber.map_update.fusion.publication_decision import ALARM, DECISION, DECISIONS, REASONS, Decisions
from camber.map_update.fusion.surface_neighbours import SurfaceNeighbourhood, build_neighbourhood
from camber.map_update.fusion.votes import NO_RANK, SAMPLES, VOTE
from camber.map_update.release import map_changes as module
from camber.map_update.release.map_changes import MOST_ROWS, map_changes, votes_by_day
from camber.road_map.release import open_release
from camber.schemas.codec import encode
from camber.schemas.fleet import HELD_REASONS, HeldChanges, MapChanges, PublishedChanges, RegionAlarms
from camber.schemas.road import ReleaseRoot
from support.small_map import MADE_NS, at, surface, write

SURFACES = 6
ROOT = ReleaseRoot(time_ns=MADE_NS, region="town", map_version=9, manifest_sha256="b" * 64)


@pytest.fixture
def neighbourhood(tmp_path: Path) -> SurfaceNeighbourhood:
    write(tmp_path, [surface(k, 20.0 * k, link_id=0) for k in range(SURFACES)], [])
    return build_neighbourhood(open_release(tmp_path).road_surfaces(), street_m=300.0, region_m=1000.0)


def changes_of(
    neighbourhood: SurfaceNeighbourhood, decided: np.ndarray, corrected: np.ndarray, alarms: np.ndarray
) -> MapChanges:
    return map_changes(
        Decisions(surfaces=decided, alarms=alarms),
        corrected,
        neighbourhood,
        root=ROOT,
        reference_sha256="a" * 64,
        time_ns=MADE_NS,
    )


def decisions(*rows: tuple[int, str, str, float]) -> np.ndarray:
    decided = np.zeros(len(rows), DECISION)
    for row, (surface_id, decision, reason, offset_m) in zip(decided, rows, strict=True):
        row["surface_id"], row["offset_m"] = surface_id, offset_m
        row["decision"], row["reason"] = DECISIONS.index(decision), REASONS.index(reason)
        row["votes"], row["vehicles"], row["agreement"] = 21, 7, 0.5
    return decided


def corrections(*rows: tuple[int, float, int]) -> np.ndarray:
    corrected = np.zeros(len(rows), CORRECTION)
    corrected["surface_id"], corrected["offset_m"], corrected["since_map_version"] = zip(*rows, strict=True)
    return corrected


NO_ALARMS, NO_CORRECTIONS = np.zeros(0, ALARM), np.zeros(0, CORRECTION)


def test_held_changes_have_place_reason_and_votes_the_largest_first(
    neighbourhood: SurfaceNeighbourhood,
) -> None:
    decided = decisions(
        (1, "hold", "step", 0.05), (2, "publish", "changed", 0.2), (3, "hold", "disagreed", -0.09)
    )
    held = changes_of(neighbourhood, decided, NO_CORRECTIONS, NO_ALARMS).held
    assert held is not None
    assert held.surface_id.tolist() == [3, 1]
    assert [HELD_REASONS[k] for k in held.reason.tolist()] == ["disagreed", "step"]
    assert (held.votes.tolist(), held.vehicles.tolist()) == ([21, 21], [7, 7])
    places = np.column_stack((held.latitude_rad, held.longitude_rad))
    assert places == pytest.approx(np.array([at(60.0, 0.0), at(20.0, 0.0)]), abs=1e-9)


def test_pending_changes_are_those_nearest_to_publication_first(neighbourhood: SurfaceNeighbourhood) -> None:
    decided = decisions(
        (1, "nothing", "too_few_days", 0.05),
        (2, "nothing", "changed_back", 0.2),
        (3, "nothing", "not_significant", -0.09),
    )
    shown = changes_of(neighbourhood, decided, NO_CORRECTIONS, NO_ALARMS)
    assert shown.pending is not None
    assert shown.pending.surface_id.tolist() == [3, 1]
    assert shown.pending.link_id.tolist() == [0, 0]
    assert [HELD_REASONS[k] for k in shown.pending.reason.tolist()] == ["not_significant", "too_few_days"]


def test_votes_of_a_day_are_counts_and_quartiles_without_voters() -> None:
    votes = np.zeros(5, VOTE)
    votes["voter"], votes["session"] = (7, 8, 9, 7, 8), (100, 100, 100, 101, 103)
    votes["rank_0"], votes["deviation_0_m"], votes["sigma_0_m"] = 1, (0.3, 0.1, 0.2, 0.25, 0.4), 0.01
    for k in range(1, SAMPLES):
        votes[f"rank_{k}"] = NO_RANK
    shown = votes_by_day(votes, time_ns=MADE_NS)
    assert date(1970, 1, 1) + timedelta(days=int(shown.day[0])) == date(1980, 1, 6) + timedelta(days=100)
    assert (shown.day.shape, shown.vehicles.tolist(), shown.left_out) == ((1,), [3], 2)
    for column, value in ((shown.low_m, 0.15), (shown.offset_m, 0.2), (shown.high_m, 0.25)):
        assert column == pytest.approx([value])
    assert len(votes_by_day(votes[:0], time_ns=MADE_NS).day) == 0


def test_the_largest_reply_has_room() -> None:
    """As `map_changes` fills it: all tables with as many rows as are kept."""
    f8, f4, i4, u1 = (np.zeros(MOST_ROWS, kind) for kind in (np.float64, np.float32, np.int32, np.uint8))
    ids = np.zeros(MOST_ROWS, np.int64)
    place = {"latitude_rad": f8, "longitude_rad": f8}
    rows = {"surface_id": ids, "link_id": ids, "offset_m": f4, "vehicles": i4, **place}
    held = HeldChanges(in_map_m=f4, standard_error_m=f4, agreement=f4, votes=i4, days=i4, reason=u1, **rows)
    published = PublishedChanges(sigma_m=f4, since_map_version=ids, **rows)
    alarms = RegionAlarms(everywhere=u1, shift_m=f4, share=f4, surfaces=i4, **place)
    tables = {"held": held, "pending": held, "published": published, "alarms": alarms}
    assert len(encode(MapChanges(time_ns=MADE_NS, status="known", map_version=2**62, **tables))) < 256_000


def test_published_changes_are_the_newest_first_without_those_that_are_none(
    neighbourhood: SurfaceNeighbourhood,
) -> None:
    corrected = corrections((0, 0.05, 8), (1, 0.0, 9), (4, -0.04, 9), (77, 0.05, 9))  # 77 is not in the map
    published = changes_of(neighbourhood, decisions(), corrected, NO_ALARMS).published
    assert published is not None
    assert published.surface_id.tolist() == [4, 0]
    assert published.offset_m == pytest.approx([-0.04, 0.05])


def test_an_alarm_is_in_the_middle_of_its_region(neighbourhood: SurfaceNeighbourhood) -> None:
    alarms = np.zeros(2, ALARM)
    alarms["region"], alarms["shift_m"], alarms["surfaces"] = (neighbourhood.region[0], -1), 0.06, SURFACES
    shown = changes_of(neighbourhood, decisions(), NO_CORRECTIONS, alarms).alarms
    assert shown is not None
    assert shown.everywhere.tolist() == [0, 1]
    inside = neighbourhood.region == neighbourhood.region[0]
    assert shown.longitude_rad[0] == pytest.approx(neighbourhood.longitude_rad[inside].mean())
    assert shown.longitude_rad[1] == pytest.approx(neighbourhood.longitude_rad.mean())


def test_what_has_no_room_is_counted(
    neighbourhood: SurfaceNeighbourhood, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_ROWS", 2)
    decided = decisions(*((k, "hold", "step", 0.01 * (k + 4)) for k in range(5)))
    shown = changes_of(neighbourhood, decided, corrections((0, 0.05, 8)), NO_ALARMS)
    assert shown.held is not None
    assert (shown.held.surface_id.tolist(), shown.left_out) == ([4, 3], 3)
