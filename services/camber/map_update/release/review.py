"""Changes of the map held for review, and the decisions of reviewers.

Files beside the releases, in `review`, each with one kind of writer:

    held.json         the changes held now, with their numbers and places; rewritten by the fusion in each cycle
    pending.json      the same of changes that wait for more votes
    rejected.json     the same of changes that would be held or published, had no operator rejected them
    decisions.jsonl   decisions with reviewer, time and reason; lines are only appended
    operators.json    the public keys of operators, if they have any, for tools; map_update trusts its settings only

A decision refers to a change of a given height: it applies as long as the votes give the same height, and lapses when
they give another one. The next fusion cycle applies it. Where operators have keys, a change is published only where
one of them signed that it is accepted; what was rejected stays so, also without a signature and after its key was
removed. `operator_decisions.py` checks and records decisions.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, Strict, ValidationError

from camber.map_update.fusion.publication_decision import DECISIONS, REASONS, Decisions
from camber.map_update.fusion.surface_neighbours import SurfaceNeighbourhood
from camber.road_map.operator_keys import OperatorKeys
from camber.road_map.release_files import write_file
from camber.road_map.road_columns import ReleaseError
from camber.schemas.base import Count
from camber.schemas.fleet import MapDecision, OffsetOfVotes, ReviewAction
from camber.schemas.plain_file import read_plain_file
from camber.schemas.refused_field import first_refused

# Chosen: a decision applies to heights within 1 cm or three standard errors; an accepted σ is at least 5 mm.
_SAME_M = 0.01
_SAME_STANDARD_ERRORS = 3.0
_LEAST_SIGMA_M = 0.005
_MOST_BYTES = 64 << 20  # chosen: over a hundred thousand decisions
_MOST_KEYS_BYTES = 1 << 20  # chosen: ten thousand operators
MOST_PENDING = 1000
"""Chosen: more than a person looks through; those nearest to publication are kept."""
MOST_REJECTED = 10_000
"""Chosen: files of some megabytes; a roll-back may withdraw more, which are listed as these are accepted again."""
_NUMBERS = (
    "previous_correction_m", "offset_m", "standard_error_m", "agreement", "vehicles", "known_vehicles", "votes", "days",
)  # fmt: skip
"""Columns of DECISION that a change has."""
_PLACE = ("link_id", "latitude_rad", "longitude_rad")
"""Columns of SurfaceNeighbourhood that it has."""
_CODED = {"signature", "withdrawn"}


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


class RecordLine(NamedTuple):
    """A line of the record: a decision, and with `roll_back` the surfaces that it withdrew, each with its offset."""

    decision: MapDecision
    withdrawn: tuple[tuple[int, float], ...] = ()

    def to_json(self) -> bytes:
        """Return the line of decisions.jsonl."""
        fields = {name: value for name, value in self.decision.__dict__.items() if value is not None}
        if self.decision.signature is not None:
            fields["signature"] = self.decision.signature.tobytes().hex()
        if self.withdrawn:
            fields["withdrawn"] = self.withdrawn
        return json.dumps(fields, ensure_ascii=False).encode() + b"\n"

    @classmethod
    def from_json(cls, line: bytes) -> RecordLine:
        """Parse a line of decisions.jsonl; raises ValueError, of which ValidationError is one."""
        fields = json.loads(line)
        if not isinstance(fields, dict):
            raise ValueError("an object")
        coded = _Coded.model_validate({name: fields.pop(name) for name in _CODED & fields.keys()})
        if coded.signature is not None:
            fields["signature"] = np.frombuffer(bytes.fromhex(coded.signature), np.uint8)
        return cls(MapDecision(**fields), coded.withdrawn)

    def outcomes(self) -> Iterator[SurfaceOutcome]:
        """Yield what it decides of each surface."""
        decision = self.decision
        for surface_id, offset_m in self.withdrawn:
            yield SurfaceOutcome(surface_id, "reject", offset_m, decision)
        if (
            decision.action != "roll_back"
            and decision.surface_id is not None
            and decision.offset_m is not None
        ):
            yield SurfaceOutcome(decision.surface_id, decision.action, decision.offset_m, decision)


class SurfaceOutcome(NamedTuple):
    """What a decision means for a surface whose votes gave `offset_m`."""

    surface_id: int
    action: Literal["accept", "reject"]
    offset_m: float
    decision: MapDecision


_Withdrawn = Annotated[tuple[Count, OffsetOfVotes], Strict(False)]  # of JSON's lists


class _Coded(BaseModel, strict=True, allow_inf_nan=False):
    """Fields of a line that are no fields of the message, or of another type there."""

    signature: Annotated[str, Field(pattern=r"^[0-9a-f]{128}$")] | None = None
    withdrawn: Annotated[tuple[_Withdrawn, ...], Strict(False)] = ()


class ReviewFolder:
    """The folder `review` of a folder of releases. Raises ReleaseError for invalid files, OSError of the disk.

    With `operators` only what one of them accepted is published, with `reference` (its manifest) only what was accepted
    on this map.
    """

    def __init__(
        self, releases: Path, operators: OperatorKeys | None = None, *, reference: str | None = None
    ) -> None:
        self._operators, self._reference = operators, reference
        self._published = releases / "review" / "operators.json"
        self._verified: dict[bytes, bool] = {}
        self._held = releases / "review" / "held.json"
        self._pending = releases / "review" / "pending.json"
        self._rejected = releases / "review" / "rejected.json"
        self._decisions = releases / "review" / "decisions.jsonl"

    def held(self) -> list[HeldChange]:
        """Return the changes held now, by surface."""
        return _read_changes(self._held)

    def pending(self) -> list[HeldChange]:
        """Return the changes that wait for more votes, those of the most standard errors first."""
        return _read_changes(self._pending)

    def rejected(self) -> list[HeldChange]:
        """Return the changes that only an operator's decision keeps away, as far as there is room."""
        return _read_changes(self._rejected)

    def lines(self) -> list[RecordLine]:
        """Return the whole record in order; an incomplete last line is ignored."""
        try:
            texts = read_plain_file(self._decisions, _MOST_BYTES).split(b"\n")
        except FileNotFoundError:
            return []
        return [self._parsed(text, number) for number, text in enumerate(texts[:-1], start=1)]

    def decisions(self) -> list[MapDecision]:
        """Return all decisions in order."""
        return [line.decision for line in self.lines()]

    def size(self) -> int:
        """Return the bytes of the record."""
        try:
            return self._decisions.stat().st_size
        except FileNotFoundError:
            return 0

    def with_room(self, lines: Sequence[RecordLine]) -> bytes:
        """Return the lines as text; ReleaseError where the record has no room for them."""
        text = b"".join(line.to_json() for line in lines)
        if self.size() + len(text) > _MOST_BYTES:
            expected = f"at most {_MOST_BYTES} bytes with {len(text)} more"
            raise ReleaseError(str(self._decisions), "size", expected, actual=f"{self.size()}")
        return text

    def append(self, lines: Sequence[RecordLine]) -> None:
        """Append to the record; the lines are on the disk when this returns. ReleaseError where it has no room."""
        text = self.with_room(lines)
        self._decisions.parent.mkdir(parents=True, exist_ok=True)
        with self._decisions.open("a+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            if file.seek(0, os.SEEK_END):
                file.seek(0)
                file.truncate(file.read().rfind(b"\n") + 1)  # remove the incomplete line of a killed writer
            file.write(text)
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
        rejected = []
        for at, action in self._applicable(rows).items():
            row = rows[at]
            if action == "reject":
                if row["decision"] != DECISIONS.index("nothing"):
                    rejected.append(at)
                row["decision"] = DECISIONS.index("nothing")
                row["correction_m"], row["sigma_m"] = row["previous_correction_m"], np.nan
            elif action == "accept" and row["decision"] == DECISIONS.index("hold"):
                row["decision"] = DECISIONS.index("publish")
                row["correction_m"] = row["offset_m"]
                row["sigma_m"] = max(float(row["standard_error_m"]), _LEAST_SIGMA_M)
            rows[at] = row
        applied = replace(decisions, surfaces=rows)
        _write_changes(self._held, applied.of("hold"), now_ns, neighbourhood)
        _write_changes(self._pending, applied.pending()[:MOST_PENDING], now_ns, neighbourhood)
        kept = decisions.surfaces[rejected[:MOST_REJECTED]]
        _write_changes(self._rejected, kept, now_ns, neighbourhood)
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

    def newest(self) -> dict[int, SurfaceOutcome]:
        """Return the last outcome for each surface, of those that apply: all that reject, and what may accept."""
        return {
            outcome.surface_id: outcome
            for line in self.lines()
            for outcome in line.outcomes()
            if outcome.action == "reject" or self._may_accept(line)
        }

    def _may_accept(self, line: RecordLine) -> bool:
        """Return whether it is on this map, and where operators have keys, one signed this very line.

        Each is verified once.
        """
        if self._reference not in (None, line.decision.reference_sha256):
            return False
        if self._operators is None:
            return True
        text = line.to_json()
        if text not in self._verified:
            try:
                self._operators.check(line.decision)
                self._verified[text] = True
            except ReleaseError:
                self._verified[text] = False
        return self._verified[text]

    def _parsed(self, text: bytes, number: int) -> RecordLine:
        try:
            return RecordLine.from_json(text)
        except ValidationError as error:
            refused = first_refused(error, whole="line")
            name, expected, actual = refused.name, refused.expected, refused.value
        except (ValueError, RecursionError):
            name, expected, actual = "line", "a decision in JSON", None
        raise ReleaseError(str(self._decisions), name, expected, actual=actual, line_number=number)

    def _applicable(self, rows: NDArray[np.void]) -> dict[int, ReviewAction]:
        """Return row → action of the last decision on its surface, if it still refers to the votes' height."""
        newest = self.newest()
        actions: dict[int, ReviewAction] = {}
        for at, surface_id in enumerate(rows["surface_id"].tolist()):
            outcome, row = newest.get(surface_id), rows[at]
            if outcome is not None and is_same_change(
                outcome.offset_m, float(row["offset_m"]), float(row["standard_error_m"])
            ):
                actions[at] = outcome.action
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
