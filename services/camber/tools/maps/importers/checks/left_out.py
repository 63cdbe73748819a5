"""Lanes that a build leaves out because they are invalid, each with its reason; and how many may be."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from camber.formats.errors import FormatError
from camber.tools.maps.importers.lanes import Floats
from camber.tools.options.number_options import number_from
from camber.tools.options.parsers import add_with_default

_MOST_PERCENT = (
    5.0  # chosen: some bad lanes in a published map are usual; more say that the file or its reading is bad
)

T = TypeVar("T")


def add_loss_arguments(parser: argparse.ArgumentParser) -> None:
    """How a map with invalid lanes is dealt with."""
    text = "refuse the map for the first invalid lane, which else is left out and listed"
    parser.add_argument("--strict", action="store_true", help=text)
    text = "of lanes, or of their area, that are invalid: above it the map is refused"
    bounds = number_from(0.0, 100.0, "%")
    add_with_default(parser, "--max-loss-percent", _MOST_PERCENT, text, type=bounds, metavar="P")


@dataclass(frozen=True, slots=True, kw_only=True)
class InvalidLane:
    """`area_m2`: None where it is not known."""

    name: str
    reason: str
    area_m2: float | None


class LeftOutLanes:
    """Collects invalid lanes; with `strict` the first one is raised."""

    def __init__(self, *, strict: bool = True, most_percent: float = _MOST_PERCENT) -> None:
        self.strict = strict
        self.lanes: list[InvalidLane] = []
        self._most_percent = most_percent

    def attempt(self, work: Callable[[], T], *, name: str, area_m2: float | None = None) -> T | None:
        """Return the result of `work`, or None where it raises FormatError: the lane `name` is left out."""
        try:
            return work()
        except FormatError as error:
            self.add(name, error, area_m2)
            return None

    def add(self, name: str, error: FormatError, area_m2: float | None = None) -> None:
        """Leave a lane out."""
        if self.strict:
            raise error
        self.lanes.append(InvalidLane(name=name, reason=str(error), area_m2=area_m2))

    def remarks(self, kept: int, kept_m2: float, file: str) -> list[str]:
        """Return a summary and a line for each lane, `kept` being the number and `kept_m2` the area of the others.

        FormatError if too much of the map is lost. A lane whose area is not known counts as the mean of those kept.
        """
        if not self.lanes:
            return []
        mean_m2 = kept_m2 / max(kept, 1)
        lost_m2 = sum(mean_m2 if lane.area_m2 is None else lane.area_m2 for lane in self.lanes)
        count = kept + len(self.lanes)
        of_lanes = 100.0 * len(self.lanes) / count
        of_area = 100.0 * lost_m2 / max(kept_m2 + lost_m2, 1e-9)
        summary = f"{len(self.lanes)} of {count} lanes, {of_area:.1f} % of the area"
        if not kept or max(of_lanes, of_area) > self._most_percent:
            expected = (
                f"at most {self._most_percent:g} % left out (--max-loss-percent), but {summary}; "
                f"the first: {self.lanes[0].reason}"
            )
            raise FormatError(file, "lanes", expected)
        return [f"{file}: left out: {summary}", *(f"  {lane.name}: {lane.reason}" for lane in self.lanes)]


def left_out_lanes(args: argparse.Namespace) -> LeftOutLanes:
    """Return what collects invalid lanes as `args` say."""
    return LeftOutLanes(strict=args.strict, most_percent=args.max_loss_percent)


def lane_area_m2(sections: Floats) -> float:
    """Return the area of cross-sections (n, k, 3) of a lane: mean widths times steps."""
    width_m = np.hypot(*(sections[:, 0, :2] - sections[:, -1, :2]).T)
    middle_m = 0.5 * (sections[:, 0, :2] + sections[:, -1, :2])
    step_m = np.hypot(*np.diff(middle_m, axis=0).T)
    return float((0.5 * (width_m[1:] + width_m[:-1]) * step_m).sum())
