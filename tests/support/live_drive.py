"""The short drive with wrong fixes every few seconds, and which verdicts on its fixes were right.

A fix is recognised by its position: errors make every position of the drive another one, and `camber feed` moves times
only. So what is confirmed can be called right or wrong whenever the drive is fed, forwards or backwards.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.replay import short_drive

TRUSTED = ("confirmed", "confirmed_after_verification")
ALERT_M = 0.5
"""A fix that is off by more is wrong; those that are made wrong are off by more than that, or by 0.35 m upwards."""

_EVERY_S, _WRONG_S = 4.0, 0.6
SCHEDULE: tuple[tuple[float, float, short_drive.State], ...] = tuple(
    (k * _EVERY_S, k * _EVERY_S + _WRONG_S, "wrong")
    for k in range(1, round(short_drive.DURATION_S / _EVERY_S))
)
"""Three wrong fixes in twenty, in thirty episodes of a drive; all others are right: there is no gap to wait for."""

BEGIN_S, END_S = 54.0, 116.0
"""What is driven of it: from one stop to the next, so that nothing jumps where the vehicle turns back."""

_DEGREES = 1e-9 * 2.0
"""Two roundings to nine decimals of a degree lie between the file and what the services say."""

Key = tuple[int, int, int]


def write_drive(folder: Path, seed: int = 1) -> Path:
    """Write the drive; returns its manifest. No pose is given: a vehicle starts from its fixes."""
    with patch.object(short_drive, "SCHEDULE", SCHEDULE):
        manifest = short_drive.write_short_drive(folder, seed)
    head, _, _ = manifest.read_text().partition("[initial_pose]")
    manifest.write_text(f"start_s = {BEGIN_S}\nend_s = {END_S}\n{head}")
    return manifest


@dataclass(frozen=True)
class Known:
    """Of the fixes of a drive: which epoch, and whether right or wrong, by position."""

    by_position: dict[Key, tuple[int, str]]

    def of(self, message: Any) -> tuple[int, str] | None:
        """Number of the epoch and `right` or `wrong`; None: no fix of this drive has that position."""
        if message.latitude_rad is None or message.longitude_rad is None:
            return None
        row, column, _ = _key(message.latitude_rad, message.longitude_rad, message.height_m)
        for up in (0, -1, 1):
            for left in (0, -1, 1):
                for higher in (0, -1, 1):
                    place = (row + up, column + left, _height(message.height_m) + higher)
                    if place in self.by_position:
                        return self.by_position[place]
        return None

    def label(self, message: Any) -> str:
        """`right`, `wrong`, or `none of the drive`."""
        known = self.of(message)
        return "none of the drive" if known is None else known[1]


def known_fixes(manifest: Path) -> Known:
    """Of a drive that `write_drive` has written."""
    solutions = PosDecoder("receiver").feed((manifest.parent / "receiver.pos").read_bytes())
    by_position: dict[Key, tuple[int, str]] = {}
    for solution in solutions:
        epoch = round((solution.time_ns - short_drive.START_NS) * short_drive.RATE_HZ / 1e9)
        time_s = epoch / short_drive.RATE_HZ
        wrong = any(begin <= round(time_s, 3) < end for begin, end, _ in SCHEDULE)
        key = _key(solution.latitude_rad, solution.longitude_rad, solution.height_m)
        by_position[key] = (epoch, "wrong" if wrong else "right")
    assert len(by_position) == len(solutions), "two fixes of the drive have the same position"
    return Known(by_position)


def count_verdicts(known: Known, fixes: Iterable[Any], verdicts: Iterable[Any]) -> Counter[tuple[str, str]]:
    """Number of verdicts by (`right` or `wrong` fix, verdict)."""
    of_fix = {fix.fix_id: known.label(fix) for fix in fixes}
    counts: Counter[tuple[str, str]] = Counter()
    for verdict in verdicts:
        if verdict.fix_id is None:
            counts["no fix", verdict.verdict] += 1
        elif verdict.verdict in TRUSTED:  # a trusted verdict has a position, which is what counts
            counts[known.label(verdict), verdict.verdict] += 1
        else:
            counts[of_fix.get(verdict.fix_id, "not received"), verdict.verdict] += 1
    return counts


def _key(latitude_rad: float, longitude_rad: float, height_m: float) -> Key:
    return (
        round(math.degrees(latitude_rad) / _DEGREES),
        round(math.degrees(longitude_rad) / _DEGREES),
        _height(height_m),
    )


def _height(height_m: float) -> int:
    return round(height_m * 1e3)
