"""Decisions of operators: checked, recorded with who and why, carried out; what is refused changes nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from pydantic import ValidationError

from camber.map_update.fusion.publication_decision import DECISION, DECISIONS, Decisions
from camber.map_update.release.operator_decisions import UnrecordedError, decide, roll_back
from camber.map_update.release.release_builder import ReleaseBuilder
from camber.map_update.release.review import RecordLine, ReviewFolder
from camber.road_map.operator_keys import OperatorKeys, load_operator_keys, sign_decision
from camber.road_map.road_columns import ReleaseError
from camber.road_map.signing_keys import key_id
from camber.schemas.fleet import MapDecision
from support.release_world import KEY, OTHER_KEY, making, offsets, public_pem
from support.small_map import MADE_NS

HERE, ELSEWHERE = "a" * 64, "b" * 64
"""References."""
LATER_NS = MADE_NS + 1


@pytest.fixture
def operators(tmp_path: Path) -> OperatorKeys:
    (tmp_path / "operators").mkdir()
    (tmp_path / "operators" / "ann.pub").write_bytes(public_pem(KEY))
    return load_operator_keys(tmp_path / "operators")


def held(folder: Path, offset_m: float = 0.31) -> Decisions:
    rows = np.zeros(1, DECISION)
    rows["surface_id"], rows["offset_m"], rows["decision"] = 4, offset_m, DECISIONS.index("hold")
    decisions = Decisions(surfaces=rows)
    ReviewFolder(folder).apply(decisions, MADE_NS)
    return decisions


def decision(key: Ed25519PrivateKey | None = KEY, **changed: Any) -> MapDecision:
    values = {"action": "accept", "surface_id": 4, "offset_m": 0.31, "who": "ann", "why": "seen on site"}
    fixed: Any = {"time_ns": MADE_NS, "reference_sha256": HERE}
    made = MapDecision(**fixed | values | changed)
    return made if key is None else sign_decision(made, key)


BACK = decision(action="roll_back", surface_id=None, offset_m=None, map_version=9)


def three_releases(folder: Path) -> ReleaseBuilder:
    builder = making(folder)
    for step, rows in enumerate((offsets(), offsets(s3=0.05), offsets(s3=0.08, s5=-0.04))):
        builder.build(rows, time_ns=MADE_NS + step)
    return builder


def result(review: ReviewFolder, decisions: Decisions) -> str:
    return DECISIONS[review.apply(decisions, MADE_NS).surfaces["decision"][0]]


def test_a_signed_decision_applies_and_the_record_shows_by_whom_and_why(
    tmp_path: Path, operators: OperatorKeys
) -> None:
    decisions, review = held(tmp_path), ReviewFolder(tmp_path, operators)
    decide(review, [decision()], now_ns=MADE_NS, operators=operators)
    assert result(review, decisions) == "publish"
    (recorded,) = review.decisions()
    assert (recorded.who, recorded.why, recorded.action) == ("ann", "seen on site", "accept")
    operators.check(recorded)


@pytest.mark.parametrize(
    ("changed", "refused"),
    [
        ({"key": None}, "signature"),
        ({"key": OTHER_KEY}, "an operator's key"),
        ({"surface_id": 5}, "one that is held"),
        ({"action": "roll_back", "surface_id": None, "offset_m": None, "map_version": 8}, "accept or reject"),
        ({"offset_m": 0.2}, r"\+0.310 m, which the votes give now"),
    ],
)
def test_what_is_refused_is_not_recorded(
    tmp_path: Path, operators: OperatorKeys, changed: dict[str, Any], refused: str
) -> None:
    held(tmp_path)
    review = ReviewFolder(tmp_path, operators)
    with pytest.raises(ReleaseError, match=refused):
        decide(review, [decision(**changed)], now_ns=MADE_NS, operators=operators)
    assert review.decisions() == []


def test_a_decision_changed_after_it_was_signed_is_refused(tmp_path: Path, operators: OperatorKeys) -> None:
    held(tmp_path)
    forged = MapDecision(**decision().__dict__ | {"why": "another reason"})
    with pytest.raises(ReleaseError, match="signature"):
        decide(ReviewFolder(tmp_path), [forged], now_ns=MADE_NS, operators=operators)


def test_a_change_is_decided_once_until_the_votes_give_another_height(
    tmp_path: Path, operators: OperatorKeys
) -> None:
    held(tmp_path)
    review = ReviewFolder(tmp_path, operators)
    decide(review, [decision()], now_ns=MADE_NS, operators=operators)
    for again in (decision(), decision(action="reject", who="ben")):
        with pytest.raises(ReleaseError, match="decided already: accept by ann"):
            decide(review, [again], now_ns=MADE_NS, operators=operators)
    held(tmp_path, 0.42)
    decide(
        review,
        [decision(action="reject", offset_m=0.42, time_ns=LATER_NS)],
        now_ns=MADE_NS,
        operators=operators,
    )
    assert [each.action for each in review.decisions()] == ["accept", "reject"]


def test_of_several_decisions_none_is_recorded_where_one_is_refused(
    tmp_path: Path, operators: OperatorKeys
) -> None:
    held(tmp_path)
    with pytest.raises(ReleaseError, match="one that is held"):
        decide(
            ReviewFolder(tmp_path), [decision(), decision(surface_id=9)], now_ns=MADE_NS, operators=operators
        )
    assert ReviewFolder(tmp_path).decisions() == []


@pytest.mark.parametrize(
    "changed",
    [
        {"who": " "},
        {"why": ""},
        {"who": "ann\x1b[2J"},
        {"why": "first\nsecond"},
        {"why": "from right to left \u202e"},
        {"map_version": 8},
        {"surface_id": None},
        {"offset_m": None},
        {"action": "roll_back"},
        {"action": "roll_back", "surface_id": None, "offset_m": None},
        {"action": "roll_back", "map_version": 8},
    ],
)
def test_a_decision_has_who_and_why_in_print_and_only_what_its_action_needs(changed: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        decision(**changed)


def test_names_and_reasons_may_be_in_any_script() -> None:
    assert decision(who="山田\u3000太郎", why="été, ёлка").who == "山田\u3000太郎"


def test_a_surface_is_decided_on_once_in_a_list(tmp_path: Path, operators: OperatorKeys) -> None:
    held(tmp_path)
    review = ReviewFolder(tmp_path, operators)
    with pytest.raises(ReleaseError, match="each once"):
        decide(review, [decision(), decision(action="reject")], now_ns=MADE_NS, operators=operators)
    assert review.decisions() == []


def test_a_signature_counts_only_for_the_line_that_was_signed(
    tmp_path: Path, operators: OperatorKeys
) -> None:
    decisions, review = held(tmp_path), ReviewFolder(tmp_path, operators)
    decide(review, [decision(action="reject")], now_ns=MADE_NS, operators=operators)
    (rejected,) = review.lines()
    record = tmp_path / "review" / "decisions.jsonl"
    forged = MapDecision(**rejected.decision.__dict__ | {"action": "accept"})
    review.append([RecordLine(forged)])
    assert result(review, decisions) == "nothing"
    record.unlink()
    other = MapDecision(**forged.__dict__ | {"surface_id": 5})
    review.append([rejected._replace(decision=decision(action="reject", surface_id=6)), RecordLine(other)])
    assert list(review.newest()) == [6]


def test_what_was_rejected_stays_so_when_keys_are_set_or_removed(
    tmp_path: Path, operators: OperatorKeys
) -> None:
    others = OperatorKeys(keys={key_id(OTHER_KEY.public_key()): OTHER_KEY.public_key()})
    for key, now in ((None, operators), (KEY, others)):
        folder = tmp_path / f"{key}"
        decisions = held(folder)
        decide(ReviewFolder(folder), [decision(key, action="reject")], now_ns=MADE_NS)
        assert result(ReviewFolder(folder, now), decisions) == "nothing"
        decisions.surfaces["decision"] = DECISIONS.index("publish")
        assert result(ReviewFolder(folder, now), decisions) == "nothing"


def test_going_back_publishes_no_surface(tmp_path: Path, operators: OperatorKeys) -> None:
    decisions = held(tmp_path)
    back = decision(action="roll_back", surface_id=None, offset_m=None, map_version=8)
    review = ReviewFolder(tmp_path, operators)
    review.append([RecordLine(back, ((4, 0.31),))])
    assert result(review, decisions) == "nothing"


def test_unsigned_lines_of_the_record_publish_nothing_where_operators_have_keys(
    tmp_path: Path, operators: OperatorKeys
) -> None:
    decisions = held(tmp_path)
    decide(ReviewFolder(tmp_path), [decision(None)], now_ns=MADE_NS)
    assert result(ReviewFolder(tmp_path), decisions) == "publish"
    assert result(ReviewFolder(tmp_path, operators), decisions) == "hold"


def test_going_back_is_recorded_signed_and_what_it_withdraws_stays_away(
    tmp_path: Path, operators: OperatorKeys
) -> None:
    builder, back = three_releases(tmp_path), BACK
    review = ReviewFolder(builder.folder, operators)
    for refused in (
        decision(
            OTHER_KEY,
            **{name: getattr(back, name) for name in ("action", "surface_id", "offset_m", "map_version")},
        ),
        decision(action="roll_back", surface_id=None, offset_m=None, map_version=77),
        decision(),
    ):
        with pytest.raises(ReleaseError):
            roll_back(review, refused, builder, time_ns=MADE_NS, operators=operators)
    assert review.decisions() == []
    done = roll_back(review, back, builder, time_ns=MADE_NS + 9, operators=operators)
    assert (done.root.map_version, done.withdrawn) == (11, 2)
    assert builder.corrections()["surface_id"].tolist() == [3]
    with pytest.raises(ReleaseError, match="the time of the last decision"):
        roll_back(review, back, builder, time_ns=MADE_NS + 10, operators=operators)
    rows = np.zeros(1, DECISION)
    rows["surface_id"], rows["offset_m"], rows["decision"] = 5, -0.04, DECISIONS.index("publish")
    assert result(review, Decisions(surfaces=rows)) == "nothing"


def test_a_decision_cannot_be_sent_again(tmp_path: Path, operators: OperatorKeys) -> None:
    held(tmp_path)
    review, accepted = ReviewFolder(tmp_path, operators), decision()
    decide(review, [accepted], now_ns=MADE_NS, operators=operators)
    held(tmp_path, 0.42)
    rejected = decision(action="reject", offset_m=0.42, time_ns=LATER_NS)
    decide(review, [rejected], now_ns=MADE_NS, operators=operators)
    decisions = held(tmp_path)
    with pytest.raises(ReleaseError, match="the time of the last decision"):
        decide(review, [accepted], now_ns=MADE_NS, operators=operators)
    assert result(ReviewFolder(tmp_path, operators), decisions) == "hold"


@pytest.mark.parametrize("seconds", [-301, 301])
def test_an_old_decision_is_refused(tmp_path: Path, operators: OperatorKeys, seconds: int) -> None:
    builder, now_ns = three_releases(tmp_path), MADE_NS + seconds * 10**9
    held(builder.folder)
    review = ReviewFolder(builder.folder, operators)
    with pytest.raises(ReleaseError, match="within 300 s"):
        decide(review, [decision()], now_ns=now_ns, operators=operators)
    with pytest.raises(ReleaseError, match="within 300 s"):
        roll_back(review, BACK, builder, time_ns=now_ns, operators=operators)
    assert review.decisions() == []


def test_what_was_accepted_on_another_map_is_not_published(tmp_path: Path, operators: OperatorKeys) -> None:
    decisions = held(tmp_path)
    decide(ReviewFolder(tmp_path), [decision(reference_sha256=ELSEWHERE)], now_ns=MADE_NS)
    assert result(ReviewFolder(tmp_path, operators, reference=HERE), decisions) == "hold"
    assert result(ReviewFolder(tmp_path, operators, reference=ELSEWHERE), decisions) == "publish"


def test_the_reference_is_signed(operators: OperatorKeys) -> None:
    with pytest.raises(ReleaseError, match="signature"):
        operators.check(MapDecision(**decision().__dict__ | {"reference_sha256": ELSEWHERE}))


def test_going_back_without_a_release_is_not_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    builder = three_releases(tmp_path)
    review, before = ReviewFolder(builder.folder), builder.corrections()

    def full(*_: Any, **__: Any) -> None:
        raise OSError("No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(builder, "roll_back", full)
        with pytest.raises(OSError, match="No space"):
            roll_back(review, BACK, builder, time_ns=MADE_NS)
    assert review.decisions() == []
    monkeypatch.setattr(review, "append", full)
    with pytest.raises(UnrecordedError, match=r"version 11 is in force, but is not recorded.*No space"):
        roll_back(review, BACK, builder, time_ns=MADE_NS)
    assert len(builder.corrections()) < len(before)


def test_nothing_is_done_where_the_record_has_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    builder = three_releases(tmp_path)
    review, before = ReviewFolder(builder.folder), builder.current()
    monkeypatch.setattr("camber.map_update.release.review._MOST_BYTES", 100)
    with pytest.raises(ReleaseError, match=r"decisions\.jsonl: size is '0', expected at most 100 bytes"):
        roll_back(review, BACK, builder, time_ns=MADE_NS)
    assert before is not None
    assert builder.current().root == before.root  # type: ignore[union-attr]
    assert review.size() == 0


def test_a_decision_to_go_back_is_one_line(tmp_path: Path) -> None:
    withdrawn = tuple((2**61 + k, -0.0123456789) for k in range(100_000))
    review = ReviewFolder(tmp_path)
    review.append([RecordLine(BACK, withdrawn)])
    assert len(review.newest()) == 100_000
    assert review.size() < 5_000_000


@pytest.mark.parametrize("automatic", ["hold", "publish"])
def test_what_was_rejected_is_listed_and_can_be_accepted(
    tmp_path: Path, operators: OperatorKeys, automatic: str
) -> None:
    decisions, review = held(tmp_path), ReviewFolder(tmp_path, operators)
    decisions.surfaces["decision"] = DECISIONS.index(automatic)
    decide(review, [decision(action="reject")], now_ns=MADE_NS, operators=operators)
    later = decision(time_ns=LATER_NS)
    with pytest.raises(ReleaseError, match="decided already"):  # until it is listed as rejected
        decide(review, [later], now_ns=MADE_NS, operators=operators)
    assert result(review, decisions) == "nothing"
    assert [each.surface_id for each in review.rejected()] == [4]
    assert review.held() == []
    with pytest.raises(ReleaseError, match="decided already: reject by ann"):
        decide(review, [decision(action="reject", time_ns=LATER_NS)], now_ns=MADE_NS, operators=operators)
    decide(review, [later], now_ns=MADE_NS, operators=operators)
    with pytest.raises(ReleaseError, match="decided already: accept by ann"):
        decide(review, [decision(time_ns=LATER_NS + 1)], now_ns=MADE_NS, operators=operators)
    assert result(review, decisions) == "publish"
    assert review.rejected() == []


def test_what_a_roll_back_withdrew_can_be_accepted_again(tmp_path: Path, operators: OperatorKeys) -> None:
    builder = three_releases(tmp_path)
    review = ReviewFolder(builder.folder, operators)
    roll_back(review, BACK, builder, time_ns=MADE_NS, operators=operators)
    rows = np.zeros(1, DECISION)
    rows["surface_id"], rows["offset_m"], rows["decision"] = 5, -0.04, DECISIONS.index("publish")
    assert result(review, Decisions(surfaces=rows)) == "nothing"
    accepted = decision(surface_id=5, offset_m=-0.04, time_ns=LATER_NS)
    decide(review, [accepted], now_ns=MADE_NS, operators=operators)
    assert result(review, Decisions(surfaces=rows)) == "publish"


def test_a_folder_without_keys_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ReleaseError, match=r"NAME\.pub"):
        load_operator_keys(tmp_path)
