"""Road surfaces and links of a map as validated columns."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.road_map.tile_checks import HIGHEST_M, LOWEST_M, MAX_ID, MAX_LEVEL
from camber.road_map.tile_grid import LIMIT_LATITUDE_RAD

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class ReleaseError(FormatError):
    """A map release, or the input of one, is invalid: file, field and expectation in one line."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RoadSurfaces:
    """Road surfaces: oriented rectangles with a grid of heights each; columns (n,), in any order.

    `yaw_rad` is counter-clockwise from east at the centre. `heights_m[i]` is (rows, columns), ellipsoidal: rows along
    from the rear to the front end, columns across from the right to the left side, each at least two; bilinear
    between. `sigma_m` is of the heights. Accepts lists; ReleaseError for an invalid column.
    """

    surface_id: Integers
    link_id: Integers
    level: Integers
    latitude_rad: Floats
    longitude_rad: Floats
    yaw_rad: Floats
    half_length_m: Floats
    half_width_m: Floats
    sigma_m: Floats
    vehicles: Integers
    last_seen_ns: Integers
    heights_m: Sequence[Floats]

    def __post_init__(self) -> None:
        _set_columns(self, "surfaces", ragged="heights_m")
        for i, grid in enumerate(self.heights_m):
            if grid.ndim != 2 or min(grid.shape) < 2:
                raise _wrong(
                    "surfaces", f"heights_m[{i}] of shape {grid.shape}", "(rows, columns), each at least 2"
                )
        _require(self, "surface_id", "0 to 2⁶²", lambda c: (c >= 0) & (c <= MAX_ID))
        _require(self, "link_id", "0 to 2⁶²", lambda c: (c >= 0) & (c <= MAX_ID))
        _require(self, "level", "-20 to 20", lambda c: np.abs(c) <= MAX_LEVEL)
        _require(self, "latitude_rad", "a latitude with tiles", lambda c: np.abs(c) < LIMIT_LATITUDE_RAD)
        _require(self, "longitude_rad", "−π to π", lambda c: np.abs(c) <= math.pi)
        _require(self, "yaw_rad", "−7 to 7", lambda c: np.abs(c) <= 7.0)
        _require(self, "half_length_m", "0.01 to 10,000", lambda c: (c >= 0.01) & (c <= 1e4))
        _require(self, "half_width_m", "0.01 to 10,000", lambda c: (c >= 0.01) & (c <= 1e4))
        _require(self, "sigma_m", "0 to 1,000", lambda c: (c >= 0.0) & (c <= 1e3))
        _require(self, "vehicles", "a count", lambda c: (c >= 0) & (c < 2**31))
        _require_unique(self.surface_id, "surfaces", "surface_id")
        reach = np.array([(grid.min(), grid.max()) for grid in self.heights_m]).reshape(-1, 2)
        inside = (reach[:, 0] >= LOWEST_M) & (reach[:, 1] <= HIGHEST_M)
        if not inside.all():
            raise _wrong("surfaces", f"heights_m[{np.argmin(inside)}]", "−19,000 to 99,000")

    def __len__(self) -> int:
        return len(self.surface_id)


@dataclass(frozen=True, eq=False, kw_only=True)
class RoadLinks:
    """Links between nodes; columns (n,), in any order; `vertices[i]` is (k, 2), latitude and longitude in radians.

    Accepts lists; ReleaseError for an invalid column.
    """

    link_id: Integers
    start_node: Integers
    end_node: Integers
    level: Integers
    sigma_m: Floats
    vertices: Sequence[Floats]

    def __post_init__(self) -> None:
        _set_columns(self, "links", ragged="vertices")
        for i, line in enumerate(self.vertices):
            if line.ndim != 2 or line.shape[1] != 2 or len(line) < 2:
                raise _wrong("links", f"vertices[{i}] of shape {line.shape}", "(k, 2) with k at least 2")
            if not (np.abs(line) <= (LIMIT_LATITUDE_RAD, math.pi)).all():
                raise _wrong("links", f"vertices[{i}]", "latitudes with tiles and longitudes from −π to π")
        _require(self, "link_id", "0 to 2⁶²", lambda c: (c >= 0) & (c <= MAX_ID))
        _require(self, "level", "-20 to 20", lambda c: np.abs(c) <= MAX_LEVEL)
        _require(self, "sigma_m", "0 to 1,000", lambda c: (c >= 0.0) & (c <= 1e3))
        _require_unique(self.link_id, "links", "link_id")

    def __len__(self) -> int:
        return len(self.link_id)


def select_links(links: RoadLinks, rows: Sequence[int]) -> RoadLinks:
    """Return some rows of links."""
    names = [field.name for field in fields(RoadLinks) if field.name != "vertices"]
    columns = {name: getattr(links, name)[list(rows)] for name in names}
    return RoadLinks(**columns, vertices=[links.vertices[row] for row in rows])


def rows_of_ids(sorted_id: Integers, wanted: Integers) -> Integers:
    """Return the rows (k,) of ids in a sorted column (n,); −1 for unknown ids."""
    if not len(sorted_id):
        return np.full(wanted.shape, -1)
    row = np.minimum(np.searchsorted(sorted_id, wanted), len(sorted_id) - 1)
    return np.where(sorted_id[row] == wanted, row, -1)


def flat_road(latitude_rad: float, longitude_rad: Sequence[float], *, seen_ns: int) -> RoadSurfaces:
    """Return surfaces of 20 m × 4 m at 50 m, of one link and with ids from 1, to warm up compiled code with."""
    n = len(longitude_rad)
    return RoadSurfaces(
        surface_id=np.arange(1, n + 1),
        link_id=np.ones(n, np.int64),
        level=np.zeros(n, np.int64),
        latitude_rad=np.full(n, latitude_rad),
        longitude_rad=np.array(longitude_rad),
        yaw_rad=np.zeros(n),
        half_length_m=np.full(n, 10.0),
        half_width_m=np.full(n, 2.0),
        sigma_m=np.full(n, 0.03),
        vehicles=np.ones(n, np.int64),
        last_seen_ns=np.full(n, seen_ns),
        heights_m=[np.full((2, 2), 50.0)] * n,
    )


def _set_columns(table: RoadSurfaces | RoadLinks, name: str, *, ragged: str) -> None:
    """Convert all columns to arrays; ReleaseError for different lengths or values that are not finite."""
    length = None
    for field in fields(table):
        value = getattr(table, field.name)
        kind = np.int64 if "Integers" in str(field.type) else np.float64
        try:
            if field.name == ragged:
                column: Any = [np.asarray(item, np.float64) for item in value]
                finite = all(np.isfinite(item).all() for item in column)
            else:
                column = np.asarray(value)
                if kind is np.int64 and len(column) and column.dtype.kind not in "iu":
                    raise _wrong(name, field.name, "integers")
                column = column.astype(kind)
                finite = column.ndim == 1 and bool(np.isfinite(column).all())
        except (TypeError, ValueError, OverflowError) as error:
            raise _wrong(name, field.name, f"numbers ({error})") from None
        if not finite:
            raise _wrong(name, field.name, "a column of finite numbers")
        if length not in (None, len(column)):
            raise _wrong(name, f"{field.name} with {len(column)} rows", f"{length} rows")
        length = len(column)
        object.__setattr__(table, field.name, column)


def _require(
    table: RoadSurfaces | RoadLinks, column: str, expected: str, right: Callable[[Any], NDArray[np.bool_]]
) -> None:
    ok = right(getattr(table, column))
    if not ok.all():
        name = "surfaces" if isinstance(table, RoadSurfaces) else "links"
        raise _wrong(name, f"{column}[{int(np.argmin(ok))}]", expected)


def _require_unique(ids: Integers, name: str, column: str) -> None:
    if len(np.unique(ids)) != len(ids):
        raise _wrong(name, column, "each id once")


def _wrong(name: str, field: str, expected: str) -> ReleaseError:
    return ReleaseError(name, field, expected)
