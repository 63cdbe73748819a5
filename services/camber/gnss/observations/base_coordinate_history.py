"""Coordinates of base stations of earlier days, by mount point and station: what is the same, and what has moved.

A coordinate is remembered once a minute of the station's single points agrees with it, and is then the one to compare
with: a later one that differs is not used until an operator confirms it, for a single point cannot distinguish a
coordinate from one two metres away, and each decides over every fix. Remembered is the first coordinate, so that many
small steps are one large one. A station that is far away from itself is another one (numbers repeat), or a new place
of the same; its single points decide as for any new station. Virtual stations are computed anew for every vehicle and
are not remembered.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from camber.formats.observations import Floats
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.observations.base_offset import BaseOffset, Vector, as_text, enu_rotation, offset_over_days
from camber.schemas.base import Count, Model

_NS_PER_DAY = 86_400 * NS_PER_SECOND
SAME_M = 0.05
"""Chosen: networks republish coordinates with some centimetres, a tenth of the tightest alert limit in use (0.57 m)."""
PLACE_M = 100.0
"""Chosen: beyond any error of a single point (20 m), so these alone separate the places."""
_MOST_DAYS, _MOST_BASES = (
    32,
    256,
)  # chosen: a month, and more stations than one vehicle meets; bounds on memory
_Metres = Annotated[float, Field(ge=-1e3, le=1e3)]
_Sigma = Annotated[float, Field(gt=0.0, le=1e3)]
_Coordinate = Annotated[float, Field(ge=-1e7, le=1e7)]
_EARTH_RADII_M = (6_346_000.0, 6_388_000.0)
"""Chosen: WGS 84's semi-axes (6,356,752 and 6,378,137 m), wider by 10 km: every place where a base can stand."""


class _Day(Model):
    """Mean of the windows of one day: single point less coordinate, east, north, up, and its σ."""

    day: Count
    windows: Annotated[int, Field(ge=1, le=100_000)]
    enu_m: tuple[_Metres, _Metres, _Metres]
    sigma_m: tuple[_Sigma, _Sigma, _Sigma]


class _Base(Model):
    mount: Annotated[str, Field(max_length=300)]
    station: Annotated[str, Field(max_length=64)]
    ecef_m: tuple[_Coordinate, _Coordinate, _Coordinate]
    days: Annotated[tuple[_Day, ...], Field(min_length=1, max_length=_MOST_DAYS)]

    @model_validator(mode="after")
    def _on_the_earth(self) -> Self:
        least_m, most_m = _EARTH_RADII_M
        if not least_m <= math.hypot(*self.ecef_m) <= most_m:
            raise ValueError(
                f"ecef_m: expected a place {least_m:.0f} to {most_m:.0f} m from the Earth's centre"
            )
        return self


class _Bases(Model):
    bases: Annotated[tuple[_Base, ...], Field(max_length=_MOST_BASES)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """How far a station's coordinate lies from the remembered one, and how many days that was in use."""

    enu_m: Vector
    days: int

    def __str__(self) -> str:
        return f"{as_text(self.enu_m)} from its coordinate on {self.days} earlier day{'s'[: self.days != 1]}"


@dataclass(slots=True, eq=False)
class BaseMemory:
    """The stations remembered, the one used last at the end; `changed`: there is something new to save."""

    bases: list[_Base] = field(default_factory=list)
    changed: bool = False

    def compare(self, mount: str, station: str, position_ecef_m: Floats) -> Move | None:
        """How a station at a coordinate (3,) has moved; None: it is where it was, or new."""
        base = self._find(mount, station, position_ecef_m)
        if base is None:
            return None
        step_m = position_ecef_m - np.array(base.ecef_m)
        if float(np.linalg.norm(step_m)) <= SAME_M:
            return None
        east, north, up = (enu_rotation(position_ecef_m) @ step_m).tolist()
        return Move(enu_m=(east, north, up), days=len(base.days))

    def offset(self, mount: str, station: str, position_ecef_m: Floats) -> BaseOffset | None:
        """Offset over the days remembered of the coordinate; None where there are too few."""
        base = self._find(mount, station, position_ecef_m)
        return None if base is None else offset_over_days([(day.enu_m, day.sigma_m) for day in base.days])

    def forget(self, mount: str, station: str, position_ecef_m: Floats) -> None:
        """Forget the station at this place: an operator has confirmed another coordinate."""
        base = self._find(mount, station, position_ecef_m)
        if base is not None:
            self.bases.remove(base)
            self.changed = True

    def remember(
        self, mount: str, station: str, position_ecef_m: Floats, *, time_ns: int, offset: BaseOffset
    ) -> None:
        """Add a window of a coordinate that its single points do not contradict and that has not moved."""
        x, y, z = position_ecef_m.tolist()
        base = self._find(mount, station, position_ecef_m)
        days = base.days if base is not None else ()
        day = time_ns // _NS_PER_DAY
        today = next((old for old in days if old.day == day), None)
        others = tuple(old for old in days if old.day != day)[-_MOST_DAYS + 1 :]
        try:
            days = (*others, _with_window(today, day, offset))
            new = _Base(
                mount=mount,
                station=station,
                ecef_m=base.ecef_m if base is not None else (x, y, z),
                days=tuple(sorted(days, key=lambda each: each.day)),
            )
        except ValidationError:
            return  # a time before 1980 or a name that no file can have: nothing to remember it by
        self.bases = [*(old for old in self.bases if old is not base), new][-_MOST_BASES:]
        self.changed = True

    def _find(self, mount: str, station: str, position_ecef_m: Floats) -> _Base | None:
        """The station at this place, the nearest of several."""
        at = [
            (float(np.linalg.norm(position_ecef_m - np.array(base.ecef_m))), number)
            for number, base in enumerate(self.bases)
            if (base.mount, base.station) == (mount, station)
        ]
        far_m, number = min(at, default=(np.inf, 0))
        return self.bases[number] if far_m <= PLACE_M else None


def _with_window(today: _Day | None, day: int, offset: BaseOffset) -> _Day:
    """Mean of the windows of a day, which share most of their errors: σ is that of one."""
    if today is None:
        return _Day(day=day, windows=1, enu_m=offset.enu_m, sigma_m=offset.sigma_m)
    n = min(today.windows, 99_999)
    means = [_mean(today.enu_m, offset.enu_m, n), _mean(today.sigma_m, offset.sigma_m, n)]
    return _Day(day=day, windows=n + 1, enu_m=means[0], sigma_m=means[1])


def _mean(before: Vector, new: Vector, n: int) -> Vector:
    east, north, up = ((n * a + b) / (n + 1) for a, b in zip(before, new, strict=True))
    return east, north, up


def memory_as_text(bases: Iterable[_Base]) -> str:
    """All stations, for a file."""
    return _Bases(bases=tuple(bases)).model_dump_json()


def memory_from_text(text: str) -> BaseMemory:
    """The reverse. Raises ValueError for values out of their bounds."""
    saved = _Bases.model_validate_json(text)
    for base in saved.bases:
        if len({day.day for day in base.days}) != len(base.days):
            raise ValueError(f"days of {base.station}: expected each day once")
    return BaseMemory(list(saved.bases))
