"""`camber map export --to geoparquet`: surfaces and links as GeoParquet for QGIS, DuckDB, GeoPandas and others.

Source: GeoParquet 1.1.0. Each row has all columns of RoadSurfaces or RoadLinks, `geometry`, which is a polygon with the
ellipsoidal heights of its corners or a line, and `bbox`. A tile is read, laid out by nanoarrow and given to arro3's
writer; memory is that of one tile and of one group of rows.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from camber.formats.map_exchange.vertical_datum import crs_of
from camber.road_map.release import Release
from camber.road_map.release_files import replaced_file
from camber.road_map.road_columns import Floats, Integers
from camber.road_map.road_tiles import (
    grid_nodes,
    link_vertices,
    surface_corners_m,
    surface_heights_m,
    surface_places,
)
from camber.road_map.tile_grid import tile_frame, tiles_of
from camber.schemas.base import UInt8
from camber.schemas.road import LinkTile, SurfaceTile

_GROUP_ROWS = (
    50_000  # chosen: some megabytes; groups of one tile would make the file's footer as large as its data
)
_COMPRESSION = "zstd(3)"
_CORNERS = 5  # of a closed ring
_POLYGON_Z, _LINE = 1003, 2  # source: OGC 06-103r4, well-known binary
_LINE_HEAD = np.dtype([("order", "u1"), ("kind", "<u4"), ("points", "<u4")])
_POLYGON = np.dtype(
    [
        ("order", "u1"), ("kind", "<u4"), ("rings", "<u4"), ("points", "<u4"), ("places", "<f8", (_CORNERS, 3)),
    ]
)  # fmt: skip
_KINDS = {
    "surface_id": "int64", "link_id": "int64", "level": "int32", "latitude_rad": "float64",
    "longitude_rad": "float64", "yaw_rad": "float64", "half_length_m": "float32", "half_width_m": "float32",
    "sigma_m": "float32", "vehicles": "int32", "last_seen_ns": "int64", "start_node": "int64", "end_node": "int64",
}  # fmt: skip
"""Arrow's types of the plain columns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _FeatureRows:
    """Some rows of a table.

    `geometry`: well-known binary of all rows, of `sizes` (n,) bytes each; `places` (m, k) are its points, of which row
    i has `first[i]` and following. `grids`: heights, with the rows (n,) and columns (n,) of each.
    """

    columns: Mapping[str, NDArray[Any]]
    geometry: UInt8
    sizes: Integers
    places: Floats
    first: Integers
    grids: tuple[Floats, Integers, Integers] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _FeatureTable:
    """Names of the plain columns, of the geometry and of its bounds."""

    names: tuple[str, ...]
    geometry_type: str
    axes: tuple[str, ...]
    has_grids: bool


_SURFACES = _FeatureTable(
    names=(
        "surface_id", "link_id", "level", "latitude_rad", "longitude_rad", "yaw_rad", "half_length_m",
        "half_width_m", "sigma_m", "vehicles", "last_seen_ns",
    ),
    geometry_type="Polygon Z", axes=("x", "y", "z"), has_grids=True,
)  # fmt: skip
_LINKS = _FeatureTable(
    names=("link_id", "start_node", "end_node", "level", "sigma_m"),
    geometry_type="LineString", axes=("x", "y"), has_grids=False,
)  # fmt: skip


def export_geoparquet(release: Release, name: str, out: Path, _: float | None) -> list[str]:
    """Write surfaces.parquet and links.parquet. Raises FormatError for a datum that PROJ does not know."""
    crs = crs_of(release.manifest.datum, name, "datum", "one that PROJ knows").geodetic_crs
    epoch_year = release.manifest.epoch_year
    surface_tiles = (t for xy in release.tiles("surfaces") if (t := release.surface_tile(*xy)) is not None)
    link_tiles = (each for xy in release.tiles("links") if (each := release.link_tile(*xy)) is not None)
    surfaces = _write(
        out / "surfaces.parquet", _SURFACES, map(_surface_rows, surface_tiles),
        _metadata(_SURFACES, crs.to_3d(), epoch_year),
    )  # fmt: skip
    links = _write(
        out / "links.parquet", _LINKS, map(_link_rows, link_tiles), _metadata(_LINKS, crs, epoch_year)
    )
    return [f"{out}: {surfaces} surfaces, {links} links, {crs.name}, GeoParquet 1.1"]


def _surface_rows(tile: SurfaceTile) -> _FeatureRows:
    """The surfaces whose centre is in this tile: those about its border are whole in others too."""
    places = dict(zip(("latitude_rad", "longitude_rad", "yaw_rad"), surface_places(tile), strict=True))
    rows = _rows_within(tile, tile.surface_id, places["latitude_rad"], places["longitude_rad"])
    columns = {
        name: (places[name] if name in places else getattr(tile, name))[rows] for name in _SURFACES.names
    }
    along, across = tile.rows[rows].astype(np.int64), tile.columns[rows].astype(np.int64)
    heights_m, nodes = surface_heights_m(tile), grid_nodes(tile, rows)[0]
    at = np.column_stack((0 * along, (along - 1) * across, along * across - 1, across - 1, 0 * along))
    ring = np.empty((len(rows), _CORNERS, 3))
    corners_m = surface_corners_m(tile)[rows][:, (0, 1, 2, 3, 0)]
    ring[:, :, :2] = _degrees_of(tile, corners_m.reshape(-1, 2)).reshape(-1, _CORNERS, 2)
    ring[:, :, 2] = heights_m[tile.first_height[rows].astype(np.int64)[:, None] + at]
    polygons = np.zeros(len(rows), _POLYGON)
    for field, value in (
        ("order", 1),
        ("kind", _POLYGON_Z),
        ("rings", 1),
        ("points", _CORNERS),
        ("places", ring),
    ):
        polygons[field] = value
    return _FeatureRows(
        columns=columns,
        geometry=polygons.view(np.uint8).ravel(),
        sizes=np.full(len(rows), _POLYGON.itemsize),
        places=ring.reshape(-1, 3),
        first=np.arange(len(rows)) * _CORNERS,
        grids=(heights_m[nodes], along, across),
    )


def _link_rows(tile: LinkTile) -> _FeatureRows:
    """The links whose first vertex is in this tile; they are whole in others too."""
    vertices = link_vertices(tile)
    begins, counts = tile.first_vertex[:-1].astype(np.int64), np.diff(tile.first_vertex).astype(np.int64)
    rows = _rows_within(tile, tile.link_id, *vertices[begins].T)
    first = np.cumsum(counts[rows]) - counts[rows]
    nodes = np.arange(counts[rows].sum()) + np.repeat(begins[rows] - first, counts[rows])
    places = np.degrees(vertices[nodes][:, ::-1])
    return _FeatureRows(
        columns={name: getattr(tile, name)[rows] for name in _LINKS.names},
        geometry=_lines(places, counts[rows]),
        sizes=_LINE_HEAD.itemsize + counts[rows] * places[:1].nbytes,
        places=places,
        first=first,
    )


def _lines(places: Floats, counts: Integers) -> UInt8:
    """Well-known binary of lines with `counts` (n,) of the points (m, 2) each."""
    heads = np.zeros(len(counts), _LINE_HEAD)
    heads["order"], heads["kind"], heads["points"] = 1, _LINE, counts
    sizes = _LINE_HEAD.itemsize + counts * places[:1].nbytes
    begins = np.cumsum(sizes) - sizes
    data = np.empty(sizes.sum(), np.uint8)
    is_head = np.zeros(len(data), bool)
    is_head[(begins[:, None] + np.arange(_LINE_HEAD.itemsize)).ravel()] = True
    data[is_head] = heads.view(np.uint8)
    data[~is_head] = np.ascontiguousarray(places, "<f8").view(np.uint8).ravel()
    return data


def _rows_within(
    tile: SurfaceTile | LinkTile, ids: Integers, latitude: Floats, longitude: Floats
) -> Integers:
    """Rows of this tile alone, by id."""
    x, y = tiles_of(latitude, longitude)
    _, once = np.unique(ids, return_index=True)
    rows: Integers = once[(x[once] == tile.x) & (y[once] == tile.y)]
    return rows


def _degrees_of(tile: SurfaceTile, east_north_m: Floats) -> Floats:
    """Longitude and latitude (n, 2) of places in the tile's plane."""
    latitude, longitude, _ = tile_frame(tile.x, tile.y).geodetic_from_east_north_array(east_north_m, 0.0)
    return np.degrees(np.column_stack((longitude, latitude)))


def _metadata(table: _FeatureTable, crs: Any, epoch_year: float) -> dict[str, Any]:
    ends = [f"{axis}{end}" for end in ("min", "max") for axis in table.axes]
    geometry = {
        "encoding": "WKB",
        "geometry_types": [table.geometry_type],
        "crs": crs.to_json_dict(),
        "epoch": epoch_year,
        "edges": "planar",
        "covering": {"bbox": {name: ["bbox", name] for name in ends}},
    }
    if table.has_grids:
        geometry["orientation"] = "counterclockwise"
    return {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": geometry}}


def _write(
    path: Path, table: _FeatureTable, rows: Iterable[_FeatureRows], metadata: Mapping[str, Any]
) -> int:
    """Write a table; returns its rows."""
    from arro3.core import RecordBatch, RecordBatchReader, Schema
    from arro3.io import write_parquet

    schema, count = _schema(table), 0

    def batches() -> Iterator[Any]:
        nonlocal count
        for part in rows:
            count += len(part.sizes)
            yield RecordBatch.from_arrow(_batch(schema, table, part))

    with replaced_file(path) as stream:
        output = _ParquetFile(stream)
        write_parquet(
            RecordBatchReader.from_batches(Schema.from_arrow(schema), output.until_failure(batches)),
            cast(BinaryIO, output),
            compression=_COMPRESSION,
            max_row_group_size=_GROUP_ROWS,
            key_value_metadata={"geo": json.dumps(metadata)},
            skip_arrow_metadata=True,
        )
        output.check()
    return count


class _ParquetFile:
    """A file whose first failure, or that of the rows, is kept and raised by `check`: arro3 would end the process's
    thread, and replace the exception by one of its own."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._failure: BaseException | None = None

    def write(self, data: bytes) -> int:
        """Write; nothing after a failure."""
        try:
            return len(data) if self._failure is not None else self._stream.write(data)
        except OSError as error:
            self._failure = error
            return len(data)

    def flush(self) -> None:
        """Nothing: the stream is flushed at its end."""

    def seek(self, offset: int, origin: int = 0) -> int:
        """As the stream; a writer needs it to be a file."""
        return self._stream.seek(offset, origin)

    def until_failure(self, make: Callable[[], Iterator[Any]]) -> Iterator[Any]:
        """What `make` yields, as long as nothing has failed."""
        try:
            for each in make():
                if self._failure is not None:
                    return
                yield each
        except Exception as error:
            self._failure = error

    def check(self) -> None:
        """Raise what has failed."""
        if self._failure is not None:
            raise self._failure


def _schema(table: _FeatureTable) -> Any:
    import nanoarrow as arrow

    fields = {name: getattr(arrow, _KINDS[name])(nullable=False) for name in table.names}
    if table.has_grids:
        fields["heights_m"] = _list_of(_list_of(arrow.float64(nullable=False)))
    ends = {f"{axis}{end}": arrow.float64(nullable=False) for end in ("min", "max") for axis in table.axes}
    fields["geometry"] = arrow.binary(nullable=False)
    fields["bbox"] = arrow.struct(ends, nullable=False)
    return arrow.struct(fields, nullable=False)


def _list_of(kind: Any) -> Any:
    import nanoarrow as arrow

    return arrow.list_(kind, nullable=False)


def _batch(schema: Any, table: _FeatureTable, rows: _FeatureRows) -> Any:
    import nanoarrow as arrow

    def array(kind: Any, length: int, *buffers: Any, children: Iterable[Any] = ()) -> Any:
        return arrow.c_array_from_buffers(kind, length, [None, *buffers], children=children)

    fields = {field.name: field for field in schema.fields}
    count, columns = len(rows.sizes), []
    for name in table.names:
        columns.append(array(fields[name], count, np.ascontiguousarray(rows.columns[name])))
    if rows.grids is not None:
        heights_m, along, across = rows.grids
        inner = fields["heights_m"].value_type
        values = array(inner.value_type, len(heights_m), heights_m)
        lines = array(inner, int(along.sum()), _offsets(np.repeat(across, along)), children=[values])
        columns.append(array(fields["heights_m"], count, _offsets(along), children=[lines]))
    columns.append(array(fields["geometry"], count, _offsets(rows.sizes), rows.geometry))
    ends = [
        reduce.reduceat(rows.places, rows.first) if count else rows.places
        for reduce in (np.minimum, np.maximum)
    ]
    bounds = [np.ascontiguousarray(column) for end in ends for column in end.T]
    parts = [array(arrow.float64(nullable=False), count, column) for column in bounds]
    columns.append(array(fields["bbox"], count, children=parts))
    return array(schema, count, children=columns)


def _offsets(sizes: Integers) -> NDArray[np.int32]:
    return np.append(0, np.cumsum(sizes)).astype(np.int32)
