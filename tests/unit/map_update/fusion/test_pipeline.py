"""A fleet's uploads become decisions: a small one of the simulator's, with changed roads, wrong drives and liars."""

from __future__ import annotations

import numpy as np
import pytest

from camber.map_update.fusion.pipeline import Fusion
from camber.map_update.fusion.votes import VOTE
from support.fleet_statistics import Run, attacked, changes_under_way, honest, run_of
from support.fleet_votes import DAY_NS
from support.small_map import surface, surfaces

NOBODY = np.zeros(0, np.int64)
SECRET = b"sixteen bytes at least"


@pytest.fixture(scope="module")
def run() -> Run:
    """Sixty vehicles, two drives of five minutes each."""
    return run_of(4, "fleet.vehicles=60", "fleet.drives_each=2", "duration_s=300.0", "fleet.rate_hz=4.0")


def test_changes_are_published_and_unchanged_roads_are_not_unlike_with_the_mean(run: Run) -> None:
    result = honest(run, 60)
    assert result["surfaces"] > 150
    assert result["ready"] > 20
    assert result["missed"] <= 1
    assert result["published"] > 20
    assert result["false"] == result["published_off"] == result["alarms"] == 0
    assert result["rmse_unchanged_mm"] < 8.0
    assert result["mean_rmse_unchanged_mm"] > 2.0 * result["rmse_unchanged_mm"]
    assert result["mean_false"] > 0


def test_a_fifth_of_a_streets_vehicles_cannot_change_the_map(run: Run) -> None:
    for result in attacked(run, 1, shares=(0.2,)):
        assert result["theirs"] == 0, result
        assert result["moved_mm"] < 10.0, result


def test_a_road_resurfaced_meanwhile_is_detected_within_a_week(run: Run) -> None:
    result = changes_under_way(run)
    assert result["seen"] >= 0.8 * result["surfaces"]
    assert result["between"] <= 0.1 * result["surfaces"]


def test_votes_of_unknown_surfaces_and_of_other_times_decide_nothing(run: Run) -> None:
    votes = run.votes.copy()
    votes["surface_id"] = -5 - np.arange(len(votes))[::-1]
    assert len(run.decide(votes).surfaces) == 0
    assert len(run.decide(run.votes, run.now_ns + 100 * DAY_NS).surfaces) == 0
    assert len(run.decide(np.zeros(0, VOTE)).surfaces) == 0


def test_a_correction_that_the_votes_confirm_stays(run: Run) -> None:
    first = run.decide(run.votes).of("publish")
    again = run.fusion.decide(run.votes, first["surface_id"], first["correction_m"], run.now_ns)
    rows = again.surfaces[np.isin(again.surfaces["surface_id"], first["surface_id"])]
    assert (rows["decision"] == 0).all()
    assert rows["correction_m"] == pytest.approx(first["correction_m"])


def test_votes_that_are_not_in_order_are_refused() -> None:
    fusion = Fusion(surfaces([surface(1)]), SECRET)
    votes = np.zeros(2, VOTE)
    with pytest.raises(ValueError, match="row 1 is not after the one before it"):
        fusion.decide(votes, NOBODY, np.zeros(0), DAY_NS)
