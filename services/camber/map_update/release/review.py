"""Changes of the map that wait for a person, and what people decided of them.

Two files beside the releases, in `review`, each with one kind of writer:

    held.json         what is held now, with its numbers; written anew by the fusion in each round
    decisions.jsonl   what was decided, by whom, when and why; lines are added, and never changed

A decision is about a change as it was seen: it holds as long as the votes say about the same height, and lapses when
they say another one. The round after it takes it in.
"""

from __future__ import annotations

import fcntl
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from camber.map_update.fusion.corrections import Corrections
from camber.map_update.fusion.publication import DECISIONS, REASONS, Decisions
from camber.road_map.release_files import write_file
from camber.road_map.road_columns import ReleaseError

ReviewAction = Literal["accept", "reject"]

SAME_M = 0.01
"""Heights that differ by less, or by three standard errors, are the one that was decided of."""
_ERRORS = 3.0
_LEAST_SIGMA_M = 0.005
_COLUMNS = (
    "previous_correction_m",
    "offset_m",
    "standard_error_m",
    "agreement",
    "vehicles",
    "known_vehicles",
    "votes",
    "days",
)


@dataclass(frozen=True)
class HeldChange:
    """A change that waits: what the map has, what the votes say, and why it was not published."""

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


@dataclass(frozen=True)
class ReviewDecision:
    """What a person decided of a surface whose votes said `offset_m`."""

    surface_id: int
    word: ReviewAction
    offset_m: float
    who: str
    why: str
    time_ns: int


class ReviewFolder:
    """The folder `review` of a folder of releases. Raises ReleaseError for files that are none, OSError of the disk."""

    def __init__(self, releases: Path) -> None:
        self._held = releases / "review" / "held.json"
        self._decisions = releases / "review" / "decisions.jsonl"

    def held(self) -> list[HeldChange]:
        """What waits now, by surface."""
        try:
            return [HeldChange(**row) for row in json.loads(self._held.read_text("utf-8"))]
        except FileNotFoundError:
            return []
        except (ValueError, TypeError, UnicodeDecodeError) as error:
            raise ReleaseError(str(self._held), "file", f"held changes ({error})") from None

    def decisions(self) -> list[ReviewDecision]:
        """All that was decided, in its order. A last line that was cut short was never decided."""
        try:
            lines = self._decisions.read_bytes().split(b"\n")
        except FileNotFoundError:
            return []
        try:
            return [ReviewDecision(**json.loads(line)) for line in lines[:-1]]
        except (ValueError, TypeError) as error:
            raise ReleaseError(str(self._decisions), "line", f"a decision ({error})") from None

    def decide(self, decided: list[ReviewDecision]) -> None:
        """Add decisions; they are on the disk when this returns."""
        for each in decided:
            if not each.who.strip() or not each.why.strip():
                raise ReleaseError("review", "who and why", "words: a decision is somebody's, for a reason")
        text = "".join(json.dumps(asdict(each), ensure_ascii=False) + "\n" for each in decided)
        self._decisions.parent.mkdir(parents=True, exist_ok=True)
        with self._decisions.open("a+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            end = file.seek(0, os.SEEK_END)
            if end:
                file.seek(0)
                whole = file.read().rfind(b"\n") + 1
                file.truncate(whole)  # of a writer that was killed
            file.write(text.encode())
            file.flush()
            os.fsync(file.fileno())

    def judged(self, decisions: Decisions, now_ns: int) -> Decisions:
        """The decisions of a round as people want them; what still waits is what `held` shows from now on.

        A change that was accepted is published though it is held, one that was rejected is not, whatever the rules say.
        """
        rows = decisions.surfaces.copy()
        for at, word in self._words(rows).items():
            row = rows[at]
            if word == "reject":
                row["decision"] = DECISIONS.index("nothing")
                row["correction_m"], row["sigma_m"] = row["previous_correction_m"], np.nan
            elif row["decision"] == DECISIONS.index("hold"):
                row["decision"] = DECISIONS.index("publish")
                row["correction_m"] = row["offset_m"]
                row["sigma_m"] = max(float(row["standard_error_m"]), _LEAST_SIGMA_M)
            rows[at] = row
        self._keep(rows[rows["decision"] == DECISIONS.index("hold")], now_ns)
        return Decisions(rows, decisions.alarms)

    def reject_again(self, withdrawn: Corrections, *, who: str, why: str, time_ns: int) -> None:
        """After a roll-back: what was withdrawn is not published again from the same votes."""
        self.decide(
            [
                ReviewDecision(int(row["surface_id"]), "reject", float(row["offset_m"]), who, why, time_ns)
                for row in withdrawn
            ]
        )

    def _words(self, rows: NDArray[np.void]) -> dict[int, ReviewAction]:
        """Row → the last decision of its surface, where that is still about what the votes say."""
        newest = {decided.surface_id: decided for decided in self.decisions()}
        found: dict[int, ReviewAction] = {}
        for at, surface_id in enumerate(rows["surface_id"].tolist()):
            decided = newest.get(surface_id)
            if decided is None:
                continue
            same_m = max(SAME_M, _ERRORS * float(rows["standard_error_m"][at]))
            if abs(decided.offset_m - float(rows["offset_m"][at])) <= same_m:
                found[at] = decided.word
        return found

    def _keep(self, rows: NDArray[np.void], now_ns: int) -> None:
        since = {held.surface_id: held.since_ns for held in self.held()}
        held = [
            HeldChange(
                surface_id=int(row["surface_id"]),
                reason=REASONS[int(row["reason"])],
                since_ns=since.get(int(row["surface_id"]), now_ns),
                **{name: row[name].item() for name in _COLUMNS},
            )
            for row in rows
        ]
        text = json.dumps([asdict(each) for each in held], indent=1).encode()
        if not self._held.exists() or self._held.read_bytes() != text:
            write_file(self._held, text)
