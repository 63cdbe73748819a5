"""Result of every kind of `camber map build`: the columns of a release and remarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from camber.road_map.road_columns import RoadLinks, RoadSurfaces
from camber.schemas.road import CloudTile


@dataclass(frozen=True, eq=False, kw_only=True)
class BuiltMap:
    """Columns and tiles for `write_release`.

    `surrogate`: not empty where the map was not surveyed, or heights are not as exact as their σ by a conversion that
    the user answers for: how it was made. `remarks`: lines for the user about omissions and their reasons.
    """

    surfaces: RoadSurfaces
    links: RoadLinks
    clouds: Sequence[CloudTile] = ()
    surrogate: str = ""
    remarks: Sequence[str] = ()
