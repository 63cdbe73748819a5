"""Changes of the map held for review, and the decisions of reviewers.

Files beside the releases, in `review`, each with one kind of writer:

    held.json         the changes held now, with their numbers and places; rewritten by the fusion in each cycle
    pending.json      the same of changes that wait for more votes
    decisions.jsonl   decisions with reviewer, time and reason; lines are only appended
    operators.json    the public keys of operators, if they have any, for tools; map_update trusts its settings only

A decision refers to a change of a given height: it applies as long as the votes give the same height, and lapses when
they give another one. The next fusion cycle applies it. Where operators have keys, a decision without the signature of
one of them does not apply. `operator_decisions.py` checks and records decisions.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.map_update.fusion.publication_decision import DECISIONS, REASONS, Decisions
from camber.map_update.fusion.surface_neighbours import SurfaceNeighbourhood
from camber.road_map.operator_keys import OperatorKeys
from camber.road_map.release_files import write_file
from camber.road_map.road_columns import ReleaseError
from camber.schemas.fleet import MapDecision, ReviewAction
from camber.schemas.plain_file import read_plain_file

# Chosen: a decision applies to heights within 1 cm or three standard errors; an accepted σ is at least 5 mm.
_SAME_M = 0.01
_SAME_STANDARD_ERRORS = 3.0
_LEAST_SIGMA_M = 0.005
_MOST_BYTES = 64 << 20  # chosen: a quarter of a million decisions
_MOST_KEYS_BYTES = 1 << 20  # chosen: ten thousand operators
MOST_PENDING = 1000
"""Chosen: more than a person looks through; those nearest to publication are kept."""
_NUMBERS = (
    "previous_correction_m", "offset_m", "standard_error_m", "agreement", "vehicles", "known_vehicles", "votes", "days",
)  # fmt: skip
"""Columns of DECISION that a change has."""
_PLACE = ("link_id", "latitude_rad", "longitude_rad")
"""Columns of SurfaceNeighbourhood that it has."""


@dataclass(frozen=True, kw_only=True)
class HeldChange:
    """A change that waits: the map's correction, the votes' offset, why it was not published, and the surface's middle.

    Files of earlier versions have neither link nor place.
    """

    surface_id: int
    reason: str
    since_ns: int
    previous_correction_m: float
    offset_m: float
    standard_error_m: float
    agreement: float
    vehicles: int
    known_vehicles: int
    votes: int
    days: int
    link_id: int | None = None
    latitude_rad: float | None = None
    longitude_rad: float | None = None


@dataclass(frozen=True, kw_only=True)
class ReviewDecision:
    """A line of the record: an operator's decision on a surface whose votes gave `offset_m`, or to go back.

    `rests_on`: the signature of the decision to go back that rejected this surface; `map_version`: back to which.
    """

    surface_id: int | None
    action: ReviewAction
    offset_m: float | None
    who: str
    why: str
    time_ns: int
    map_version: int | None = None
    key_id: str | None = None
    signature: str | None = None
    rests_on: str | None = None

    def to_json(self) -> str:
        """Return the line of decisions.jsonl, in which `action` is called `word`."""
        fields = {"word" if name == "action" else name: value for name, value in asdict(self).items()}
        return json.dumps(fields, ensure_ascii=False)

    @classmethod
    def from_json(cls, line: bytes) -> ReviewDecision:
        """Parse a line of decisions.jsonl; raises ValueError or TypeError."""
        fields = json.loads(line)
        return cls(**{"action" if name == "word" else name: value for name, value in fields.items()})

    @classmethod
    def from_message(cls, message: MapDecision) -> ReviewDecision:
        """Return the line of a decision."""
        values = {name: value for name, value in message.__dict__.items() if name != "signature"}
        signature = None if message.signature is None else message.signature.tobytes().hex()
        return cls(**values, signature=signature)

    def to_message(self) -> MapDecision:
        """Return the decision as it was signed; raises ValueError for an impossible one."""
        values = {name: value for name, value in asdict(self).items() if name != "rests_on"}
        if self.signature is not None:
            values["signature"] = np.frombuffer(bytes.fromhex(self.signature), np.uint8)
        return MapDecision(**values)


class ReviewFolder:
    """The folder `review` of a folder of releases. Raises ReleaseError for invalid files, OSError of the disk.

    With `operators` only decisions that one of them signed apply.
    """

    def __init__(self, releases: Path, operators: OperatorKeys | None = None) -> None:
        self._operators = operators
        self._published = releases / "review" / "operators.json"
        self._verified: dict[str, bool] = {}
        self._held = releases / "review" / "held.json"
        self._pending = releases / "review" / "pending.json"
        self._decisions = releases / "review" / "decisions.jsonl"

    def held(self) -> list[HeldChange]:
        """Return the changes held now, by surface."""
        return _read_changes(self._held)

    def pending(self) -> list[HeldChange]:
        """Return the changes that wait for more votes, those of the most standard errors first."""
        return _read_changes(self._pending)

    def decisions(self) -> list[ReviewDecision]:
        """Return all decisions in order; an incomplete last line is ignored."""
        try:
            lines = read_plain_file(self._decisions, _MOST_BYTES).split(b"\n")
        except FileNotFoundError:
            return []
        try:
            return [ReviewDecision.from_json(line) for line in lines[:-1]]
        except (ValueError, TypeError, AttributeError) as error:
            raise ReleaseError(str(self._decisions), "line", f"a decision ({error})") from None

    def append(self, decisions: list[ReviewDecision]) -> None:
        """Append decisions; they are on the disk when this returns."""
        for each in decisions:
            if not each.who.strip() or not each.why.strip():
                raise ReleaseError("review", "who and why", "text: a decision has an author and a reason")
        text = "".join(f"{each.to_json()}\n" for each in decisions)
        self._decisions.parent.mkdir(parents=True, exist_ok=True)
        with self._decisions.open("a+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            if file.seek(0, os.SEEK_END):
                file.seek(0)
                file.truncate(file.read().rfind(b"\n") + 1)  # remove the incomplete line of a killed writer
            file.write(text.encode())
            file.flush()
            os.fsync(file.fileno())

    def apply(
        self, decisions: Decisions, now_ns: int, neighbourhood: SurfaceNeighbourhood | None = None
    ) -> Decisions:
        """Return the fusion's decisions changed by those of reviewers; what still waits is written to its files.

        An accepted change is published though it is held; a rejected one is not published. `neighbourhood` has the
        places of surfaces.
        """
        rows = decisions.surfaces.copy()
        for at, action in self._applicable(rows).items():
            row = rows[at]
            if action == "reject":
                row["decision"] = DECISIONS.index("nothing")
                row["correction_m"], row["sigma_m"] = row["previous_correction_m"], np.nan
            elif row["decision"] == DECISIONS.index("hold"):
                row["decision"] = DECISIONS.index("publish")
                row["correction_m"] = row["offset_m"]
                row["sigma_m"] = max(float(row["standard_error_m"]), _LEAST_SIGMA_M)
            rows[at] = row
        applied = replace(decisions, surfaces=rows)
        _write_changes(self._held, applied.of("hold"), now_ns, neighbourhood)
        _write_changes(self._pending, applied.pending()[:MOST_PENDING], now_ns, neighbourhood)
        return applied

    def publish_operators(self) -> None:
        """Write the keys of operators for tools, or remove them where there are none."""
        if self._operators is None:
            self._published.unlink(missing_ok=True)
        else:
            write_file(self._published, self._operators.to_json().encode())

    def published_operators(self) -> OperatorKeys | None:
        """Return the keys of operators as map_update wrote them; None: it has none."""
        try:
            return OperatorKeys.from_json(read_plain_file(self._published, _MOST_KEYS_BYTES))
        except FileNotFoundError:
            return None
        except (ValueError, TypeError, AttributeError) as error:
            raise ReleaseError(str(self._published), "file", f"keys of operators ({error})") from None

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Exclude others who check and record decisions."""
        self._decisions.parent.mkdir(parents=True, exist_ok=True)
        with (self._decisions.parent / ".deciding").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def newest(self) -> dict[int, ReviewDecision]:
        """Return the last decision on each surface, of those that apply."""
        decisions = self.decisions()
        verified = {each.signature for each in decisions if self._is_verified(each)}
        return {
            each.surface_id: each
            for each in decisions
            if each.surface_id is not None
            and (self._operators is None or (each.rests_on or each.signature) in verified)
        }

    def _is_verified(self, decision: ReviewDecision) -> bool:
        """Return whether an operator signed it; each is verified once."""
        if self._operators is None or decision.signature is None:
            return False
        line = decision.to_json()
        if line not in self._verified:
            try:
                self._operators.check(decision.to_message())
                self._verified[line] = True
            except (ReleaseError, ValueError):
                self._verified[line] = False
        return self._verified[line]

    def _applicable(self, rows: NDArray[np.void]) -> dict[int, ReviewAction]:
        """Return row → action of the last decision on its surface, if it still refers to the votes' height."""
        newest = self.newest()
        actions: dict[int, ReviewAction] = {}
        for at, surface_id in enumerate(rows["surface_id"].tolist()):
            decision = newest.get(surface_id)
            if decision is None or decision.offset_m is None:
                continue
            row = rows[at]
            if is_same_change(decision.offset_m, float(row["offset_m"]), float(row["standard_error_m"])):
                actions[at] = decision.action
        return actions


def is_same_change(decided_m: float, offset_m: float, standard_error_m: float) -> bool:
    """Return whether votes that give `offset_m` still give the height that was decided on."""
    return abs(decided_m - offset_m) <= max(_SAME_M, _SAME_STANDARD_ERRORS * standard_error_m)


def _read_changes(path: Path) -> list[HeldChange]:
    try:
        return [HeldChange(**row) for row in json.loads(read_plain_file(path, _MOST_BYTES))]
    except FileNotFoundError:
        return []
    except (ValueError, TypeError, UnicodeDecodeError) as error:
        raise ReleaseError(str(path), "file", f"changes of surfaces ({error})") from None


def _write_changes(
    path: Path, rows: NDArray[np.void], now_ns: int, neighbourhood: SurfaceNeighbourhood | None
) -> None:
    """Write rows of DECISION; one that is in the file already keeps its time."""
    since = {change.surface_id: change.since_ns for change in _read_changes(path)}
    changes = []
    for row in rows:
        surface_id = int(row["surface_id"])
        change = HeldChange(
            surface_id=surface_id,
            reason=REASONS[int(row["reason"])],
            since_ns=since.get(surface_id, now_ns),
            **{name: row[name].item() for name in _NUMBERS},
            **_place(surface_id, neighbourhood),
        )
        changes.append(asdict(change))
    text = json.dumps(changes, indent=1).encode()
    if not path.exists() or path.read_bytes() != text:
        write_file(path, text)


def _place(surface_id: int, neighbourhood: SurfaceNeighbourhood | None) -> dict[str, Any]:
    at = -1 if neighbourhood is None else int(neighbourhood.rows_of(np.array([surface_id]))[0])
    if neighbourhood is None or at < 0:
        return {}
    return {name: getattr(neighbourhood, name)[at].item() for name in _PLACE}
