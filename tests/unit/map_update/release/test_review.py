"""Decisions on held changes are stored, refer to the change as it was seen, and apply in the next cycle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.map_update.fusion.publication_decision import DECISION, DECISIONS, REASONS, Decision, Decisions
from camber.map_update.fusion.surface_neighbours import build_neighbourhood
from camber.map_update.release.review import RecordLine, ReviewFolder
from camber.road_map.road_columns import ReleaseError
from camber.schemas.fleet import MapDecision, ReviewAction
from support.small_map import MADE_NS, at, surface, surfaces


def decisions(*rows: tuple[int, Decision, float]) -> Decisions:
    decided = np.zeros(len(rows), DECISION)
    for row, (surface_id, decision, offset_m) in zip(decided, rows, strict=True):
        row["surface_id"], row["decision"], row["offset_m"] = surface_id, DECISIONS.index(decision), offset_m
        row["reason"], row["standard_error_m"], row["sigma_m"] = REASONS.index("step"), 0.002, np.nan
        row["vehicles"], row["agreement"] = 9, 0.9
        if decision == "publish":
            row["correction_m"], row["sigma_m"] = offset_m, 0.01
    return Decisions(surfaces=decided)


def review_decision(surface_id: int, action: ReviewAction, offset_m: float) -> RecordLine:
    by: Any = {"who": "ann", "why": "seen on site", "time_ns": MADE_NS, "reference_sha256": "a" * 64}
    return RecordLine(MapDecision(surface_id=surface_id, action=action, offset_m=offset_m, **by))


def outcomes(decisions: Decisions) -> list[str]:
    return [DECISIONS[number] for number in decisions.surfaces["decision"]]


def test_held_changes_are_listed_with_their_numbers_and_time(tmp_path: Path) -> None:
    review = ReviewFolder(tmp_path)
    assert review.held() == []
    review.apply(decisions((3, "hold", 0.2), (5, "publish", 0.1)), MADE_NS)
    review.apply(decisions((3, "hold", 0.21), (5, "nothing", 0.1)), MADE_NS + 5)
    (held,) = review.held()
    assert (held.surface_id, held.offset_m, held.reason, held.since_ns) == (3, 0.21, "step", MADE_NS)
    review.apply(decisions((3, "nothing", 0.0)), MADE_NS + 6)
    assert review.held() == []


def test_changes_that_wait_have_link_and_place(tmp_path: Path) -> None:
    rows = [surface(k, 20.0 * k, link_id=9) for k in range(4)]
    neighbourhood = build_neighbourhood(surfaces(rows), street_m=300.0, region_m=1000.0)
    review = ReviewFolder(tmp_path)
    decided = decisions((2, "hold", 0.2), (3, "nothing", 0.1), (77, "hold", 0.2))
    decided.surfaces["reason"][1], decided.surfaces["votes"] = REASONS.index("too_few_days"), 3
    review.apply(decided, MADE_NS, neighbourhood)
    held, elsewhere = review.held()
    assert held.link_id == 9
    assert (held.latitude_rad, held.longitude_rad) == pytest.approx(at(40.0, 0.0), abs=1e-9)
    assert (elsewhere.surface_id, elsewhere.latitude_rad) == (77, None)
    (pending,) = review.pending()
    assert (pending.surface_id, pending.reason, pending.link_id) == (3, "too_few_days", 9)


def test_pending_are_changes_beyond_the_threshold_that_more_votes_may_publish(tmp_path: Path) -> None:
    decided = decisions(
        (1, "nothing", 0.04),
        (2, "nothing", 0.02),
        (3, "nothing", -0.09),
        (4, "nothing", 0.2),
        (5, "hold", 0.3),
    )
    decided.surfaces["reason"] = REASONS.index("not_significant")
    decided.surfaces["reason"][3] = REASONS.index("changed_back")
    decided.surfaces["votes"] = 3
    ReviewFolder(tmp_path).apply(Decisions(surfaces=decided.surfaces, threshold_m=0.03), MADE_NS)
    assert [change.surface_id for change in ReviewFolder(tmp_path).pending()] == [3, 1]


def test_held_changes_of_earlier_versions_are_read_without_place(tmp_path: Path) -> None:
    review = ReviewFolder(tmp_path)
    review.apply(decisions((3, "hold", 0.2)), MADE_NS)
    path = tmp_path / "review" / "held.json"
    rows = json.loads(path.read_text())
    for name in ("link_id", "latitude_rad", "longitude_rad"):
        del rows[0][name]
    path.write_text(json.dumps(rows))
    (held,) = review.held()
    assert (held.surface_id, held.link_id, held.latitude_rad) == (3, None, None)


def test_an_accepted_change_is_published_and_no_longer_held(tmp_path: Path) -> None:
    review = ReviewFolder(tmp_path)
    review.append([review_decision(3, "accept", 0.2)])
    result = review.apply(decisions((3, "hold", 0.205), (4, "hold", 0.2)), MADE_NS)
    assert outcomes(result) == ["publish", "hold"]
    assert (result.surfaces["correction_m"][0], result.surfaces["sigma_m"][0]) == (0.205, 0.005)
    assert [held.surface_id for held in review.held()] == [4]


@pytest.mark.parametrize("action", ["hold", "publish"])
def test_a_rejected_change_is_not_published_until_the_votes_give_another_height(
    tmp_path: Path, action: Decision
) -> None:
    review = ReviewFolder(tmp_path)
    review.append([review_decision(3, "reject", 0.2)])
    result = review.apply(decisions((3, action, 0.205)), MADE_NS)
    assert outcomes(result) == ["nothing"]
    assert result.surfaces["correction_m"][0] == 0.0
    assert np.isnan(result.surfaces["sigma_m"][0])
    assert review.held() == []
    assert outcomes(review.apply(decisions((3, action, 0.25)), MADE_NS)) == [action]


def test_the_last_decision_applies_and_all_are_stored(tmp_path: Path) -> None:
    review = ReviewFolder(tmp_path)
    for action in ("accept", "reject", "accept"):
        review.append([review_decision(3, action, 0.2)])  # type: ignore[arg-type]
    assert [each.action for each in ReviewFolder(tmp_path).decisions()] == ["accept", "reject", "accept"]
    assert outcomes(review.apply(decisions((3, "hold", 0.2)), MADE_NS)) == ["publish"]


def test_an_incomplete_line_is_no_decision(tmp_path: Path) -> None:
    review = ReviewFolder(tmp_path)
    review.append([review_decision(3, "accept", 0.2)])
    path = tmp_path / "review" / "decisions.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole + whole[: len(whole) // 2])
    assert len(review.decisions()) == 1
    review.append([review_decision(4, "reject", 0.1)])
    assert [each.surface_id for each in review.decisions()] == [3, 4]


LINE = {
    "surface_id": 4,
    "action": "accept",
    "offset_m": 0.2,
    "who": "ann",
    "why": "seen",
    "time_ns": MADE_NS,
    "reference_sha256": "a" * 64,
}


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"action": "bogus"}, "action is 'bogus', expected"),
        ({"action": "roll_back", "map_version": 8}, "roll_back without surface_id"),
        ({"offset_m": None}, "accept with offset_m"),
        ({"offset_m": "x"}, "offset_m is 'x'"),
        ({"offset_m": float("nan")}, "offset_m is 'nan'"),
        ({"surface_id": [4]}, "surface_id is"),
        ({"signature": 5, "key_id": "a"}, "signature is '5'"),
        ({"signature": "zz", "key_id": "a"}, "signature is 'zz'"),
        ({"key_id": "a"}, "key_id and signature, or neither"),
        ({"withdrawn": [[4, "x"]]}, "withdrawn.0.1 is 'x'"),
        ({"who": " "}, "who is ' ', expected printable"),
        ({"why": "\x1b[2J"}, "expected printable characters"),
        ({"rests_on": "00"}, "rests_on"),
    ],
)
def test_a_line_that_is_no_decision_is_named_with_its_number_and_publishes_nothing(
    tmp_path: Path, changed: dict[str, Any], named: str
) -> None:
    review = ReviewFolder(tmp_path)
    review.append([review_decision(3, "accept", 0.2)])
    with (tmp_path / "review" / "decisions.jsonl").open("a") as record:
        record.write(json.dumps(LINE | changed) + "\n")
    with pytest.raises(ReleaseError) as caught:
        review.apply(decisions((4, "hold", 0.2)), MADE_NS)
    assert "decisions.jsonl:2: " in str(caught.value)
    assert named in str(caught.value)


@pytest.mark.parametrize("text", ["[1]", "5", "{", "", "[" * 5000])
def test_a_line_that_is_no_object_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "review").mkdir()
    (tmp_path / "review" / "decisions.jsonl").write_text(text + "\n")
    with pytest.raises(ReleaseError, match=r"decisions\.jsonl:1: line, expected a decision in JSON"):
        ReviewFolder(tmp_path).decisions()


@pytest.mark.parametrize("name", ["held.json", "decisions.jsonl"])
def test_damaged_files_are_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "review").mkdir()
    (tmp_path / "review" / name).write_text(json.dumps([{"word": 1}]) + "\n")
    with pytest.raises(ReleaseError, match=name):
        ReviewFolder(tmp_path).apply(decisions((3, "hold", 0.2)), MADE_NS)
