"""Decisions of operators on changes of the map, for the command line and the bus alike: checked, recorded, carried out.

A decision is refused where it has no valid signature of an operator (if operators have keys), where it is minutes old
or not newer than the last one, where its change is not held, where the votes give another height by now, and where the
change was decided on before; but what was rejected can be accepted later. What is recorded is on
the disk when `decide` returns. The fusion's next cycle applies what was accepted and rejected; going back makes a
release at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from camber.map_update.fusion.correction_rows import Corrections
from camber.map_update.release.release_builder import ReleaseBuilder, corrections_of, history
from camber.map_update.release.review import (
    HeldChange,
    RecordLine,
    ReviewFolder,
    SurfaceOutcome,
    is_same_change,
)
from camber.road_map.operator_keys import OperatorKeys
from camber.road_map.release_files import ReleaseFolder
from camber.road_map.road_columns import ReleaseError
from camber.schemas.fleet import MapDecision
from camber.schemas.road import ReleaseRoot

_MOST_AGE_NS = 300 * 10**9  # chosen: a clock of an operator may differ by minutes, an old decision is refused


class RolledBack(NamedTuple):
    """The release that has the corrections of an earlier one, and how many corrections it withdrew."""

    root: ReleaseRoot
    withdrawn: int


class UnrecordedError(ReleaseError):
    """A release was made as decided, but the record could not be written."""


def decide(
    review: ReviewFolder,
    decisions: Sequence[MapDecision],
    *,
    now_ns: int,
    operators: OperatorKeys | None = None,
) -> None:
    """Record decisions to accept or reject changes: all, or none and a ReleaseError. OSError of the disk."""
    surfaces = [decision.surface_id for decision in decisions]
    if len(set(surfaces)) < len(surfaces):
        raise ReleaseError("decision", "surface", "each once")
    with review.locked():
        held = {change.surface_id: change for change in review.held()}
        rejected = {change.surface_id: change for change in review.rejected()}
        newest = review.newest()
        for decision in decisions:
            if operators is not None:
                operators.check(decision)
            _check_time(decision, now_ns)
            _check_change(decision, held, rejected, newest)
        review.append([RecordLine(decision) for decision in decisions])


def roll_back(
    review: ReviewFolder,
    decision: MapDecision,
    builder: ReleaseBuilder,
    *,
    time_ns: int,
    operators: OperatorKeys | None = None,
) -> RolledBack:
    """Make the release and record the decision with what it withdraws, so that the same votes do not publish it again.

    ReleaseError for one that is refused: nothing was done. UnrecordedError where the release is in force.
    """
    if decision.action != "roll_back" or decision.map_version is None:
        raise ReleaseError("decision", "map_version", "a version to go back to")
    with review.locked():
        if operators is not None:
            operators.check(decision)
        _check_time(decision, time_ns)
        before = [each.time_ns for each in review.decisions() if each.action == "roll_back"]
        if before:
            _check_newer(decision, before[-1])
        target = _corrections_at(builder, decision.map_version)
        rows = other_offsets(builder.corrections(), target)[["surface_id", "offset_m"]]
        withdrawn = tuple((int(surface_id), float(offset_m)) for surface_id, offset_m in rows)
        line = RecordLine(decision, withdrawn)
        review.with_room([line])
        root = builder.roll_back(decision.map_version, time_ns=time_ns)
        try:
            review.append([line])
        except (OSError, ReleaseError) as error:
            expected = (
                f"a line on it: version {root.map_version} is in force, but is not recorded, and the "
                f"fusion may publish again what it withdrew ({error})"
            )
            raise UnrecordedError(str(builder.folder), "roll_back", expected) from None
    return RolledBack(root, len(withdrawn))


def other_offsets(mine: Corrections, theirs: Corrections, *, gone: bool = False) -> Corrections:
    """The rows of `mine` whose surface has another offset in `theirs`; with `gone` only those it does not have."""
    at = np.searchsorted(theirs["surface_id"], mine["surface_id"])
    there = at < len(theirs)
    there[there] = theirs["surface_id"][at[there]] == mine["surface_id"][there]
    other = ~there
    if not gone:
        other[there] = theirs["offset_m"][at[there]] != mine["offset_m"][there]
    rows: Corrections = mine[other]
    return rows


def _check_time(decision: MapDecision, now_ns: int) -> None:
    """Raise ReleaseError for an old decision: it may be one that was refused, and is sent again."""
    if abs(now_ns - decision.time_ns) > _MOST_AGE_NS:
        expected = f"within {_MOST_AGE_NS // 10**9} s of {now_ns}, the time here"
        raise ReleaseError("decision", "time_ns", expected, actual=str(decision.time_ns))


def _check_newer(decision: MapDecision, before_ns: int) -> None:
    """Raise ReleaseError unless it is newer than the last one: one that is recorded cannot be sent again."""
    if decision.time_ns <= before_ns:
        expected = f"after {before_ns}, the time of the last decision"
        raise ReleaseError("decision", "time_ns", expected, actual=str(decision.time_ns))


def _check_change(
    decision: MapDecision,
    held: dict[int, HeldChange],
    rejected: dict[int, HeldChange],
    newest: dict[int, SurfaceOutcome],
) -> None:
    """Raise ReleaseError unless this change is held, has this height, and was not decided on.

    A change that is listed as rejected can be accepted.
    """
    surface_id, offset_m = decision.surface_id, decision.offset_m
    if surface_id is None or offset_m is None:
        raise ReleaseError("decision", "action", "accept or reject", actual=decision.action)
    change, before = held.get(surface_id, rejected.get(surface_id)), newest.get(surface_id)
    error_m = 0.0 if change is None else change.standard_error_m
    again = surface_id in rejected and decision.action == "accept"
    if (
        before is not None
        and is_same_change(before.offset_m, offset_m, error_m)
        and not (again and before.action == "reject")
    ):
        decided = f"decided already: {before.action} by {before.decision.who}"
        raise ReleaseError("decision", "surface", "one without a decision", actual=f"{surface_id}, {decided}")
    if before is not None:
        _check_newer(decision, before.decision.time_ns)
    if change is None:
        raise ReleaseError("decision", "surface", "one that is held", actual=str(surface_id))
    if not is_same_change(offset_m, change.offset_m, error_m):
        expected = f"{change.offset_m:+.3f} m, which the votes give now"
        raise ReleaseError("decision", "offset_m", expected, actual=f"{offset_m:+.3f} m")


def _corrections_at(builder: ReleaseBuilder, map_version: int) -> Corrections:
    manifests = {record.manifest.map_version: record.manifest for record in history(builder.folder)}
    if map_version not in manifests:
        versions = ", ".join(map(str, manifests))
        raise ReleaseError(str(builder.folder), "version", f"one of {versions}", actual=str(map_version))
    return corrections_of(ReleaseFolder(builder.folder), manifests[map_version])
