"""Changes for viewers: places of surfaces and regions, the largest held and the newest published first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camber.map_update.fusion.correction_rows import CORRECTION
from camber.map_update.fusion.publication_decision import ALARM, DECISION, DECISIONS, REASONS, Decisions
from camber.map_update.fusion.surface_neighbours import SurfaceNeighbourhood, build_neighbourhood
from camber.map_update.release import map_changes as module
from camber.map_update.release.map_changes import map_changes
from camber.road_map.release import open_release
from camber.schemas.fleet import HELD_REASONS, MapChanges
from support.small_map import MADE_NS, at, surface, write

SURFACES = 6


@pytest.fixture
def neighbourhood(tmp_path: Path) -> SurfaceNeighbourhood:
    write(tmp_path, [surface(k, 20.0 * k, link_id=0) for k in range(SURFACES)], [])
    return build_neighbourhood(open_release(tmp_path).road_surfaces(), street_m=300.0, region_m=1000.0)


def changes_of(
    neighbourhood: SurfaceNeighbourhood, decided: np.ndarray, corrected: np.ndarray, alarms: np.ndarray
) -> MapChanges:
    return map_changes(
        Decisions(surfaces=decided, alarms=alarms), corrected, neighbourhood, map_version=9, time_ns=MADE_NS
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
