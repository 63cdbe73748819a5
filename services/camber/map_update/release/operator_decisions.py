"""Decisions of operators on changes of the map, for the command line and the bus alike: checked, recorded, carried out.

A decision is refused where it has no valid signature of an operator (if operators have keys), where its change is not
held, where the votes give another height by now, and where the change was decided on before. What is recorded is on
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


class RolledBack(NamedTuple):
    """The release that has the corrections of an earlier one, and how many corrections it withdrew."""

    root: ReleaseRoot
    withdrawn: int


def decide(
    review: ReviewFolder, decisions: Sequence[MapDecision], operators: OperatorKeys | None = None
) -> None:
    """Record decisions to accept or reject changes: all, or none and a ReleaseError. OSError of the disk."""
    surfaces = [decision.surface_id for decision in decisions]
    if len(set(surfaces)) < len(surfaces):
        raise ReleaseError("decision", "surface", "each once")
    with review.locked():
        held = {change.surface_id: change for change in review.held()}
        newest = review.newest()
        for decision in decisions:
            if operators is not None:
                operators.check(decision)
            _check_change(decision, held, newest)
        review.append([RecordLine(decision) for decision in decisions])


def roll_back(
    review: ReviewFolder,
    decision: MapDecision,
    builder: ReleaseBuilder,
    *,
    time_ns: int,
    operators: OperatorKeys | None = None,
) -> RolledBack:
    """Record a decision to go back with what it withdraws, so that the same votes do not publish it again, and make
    the release. ReleaseError for one that is refused."""
    if decision.action != "roll_back" or decision.map_version is None:
        raise ReleaseError("decision", "map_version", "a version to go back to")
    with review.locked():
        if operators is not None:
            operators.check(decision)
        if decision in review.decisions():
            raise ReleaseError("decision", "roll_back", "one that was not made before")
        target = _corrections_at(builder, decision.map_version)
        rows = other_offsets(builder.corrections(), target)[["surface_id", "offset_m"]]
        withdrawn = tuple((int(surface_id), float(offset_m)) for surface_id, offset_m in rows)
        review.append([RecordLine(decision, withdrawn)])
    return RolledBack(builder.roll_back(decision.map_version, time_ns=time_ns), len(withdrawn))


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


def _check_change(
    decision: MapDecision, held: dict[int, HeldChange], newest: dict[int, SurfaceOutcome]
) -> None:
    """Raise ReleaseError unless this change is held, has this height, and was not decided on."""
    surface_id, offset_m = decision.surface_id, decision.offset_m
    if surface_id is None or offset_m is None:
        raise ReleaseError("decision", "action", "accept or reject", actual=decision.action)
    change, before = held.get(surface_id), newest.get(surface_id)
    error_m = 0.0 if change is None else change.standard_error_m
    if before is not None and is_same_change(before.offset_m, offset_m, error_m):
        decided = f"decided already: {before.action} by {before.decision.who}"
        raise ReleaseError("decision", "surface", "one without a decision", actual=f"{surface_id}, {decided}")
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
