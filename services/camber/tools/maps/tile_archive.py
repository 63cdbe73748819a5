"""`camber map export --to pmtiles`: the map as vector tiles in one file, with the layers of the live page.

Zoom 15 and 16: road surfaces (`sigma`, `level`, `day` of the last observation, `height`) and links. 12 to 14: links.
6 to 11: links on a grid, once for each pair of its cells: what a screen distinguishes. Tiles are made one after
another, in the order of the file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.map_exchange.pmtiles import PmtilesWriter, first_number, hilbert_numbers
from camber.live.map_tiles import (
    LEAST_ZOOM,
    LINK_ZOOM,
    SURFACE_ZOOM,
    MapSource,
    ReleaseSource,
    TilePlace,
    link_layers,
    surface_layers,
)
from camber.live.vector_tiles import EXTENT, TileLayer, encode_tile
from camber.road_map.release import Release
from camber.road_map.release_files import replaced_file
from camber.road_map.road_tiles import link_vertices
from camber.road_map.tile_grid import Tile, world_shares
from camber.schemas.base import Int64
from camber.schemas.road import ZOOM

_CELL = 32  # units of a tile; chosen: two pixels of a tile that is drawn with 512
_READ_AT_ONCE = 256  # tiles of links; chosen: bounds memory
_FIELDS = {
    "surfaces": {"sigma": "Number", "level": "Number", "day": "Number", "height": "Number"},
    "links": {"level": "Number"},
}


def export_pmtiles(release: Release, name: str, out: Path, _: float | None) -> list[str]:
    """Write one file. Raises FormatError for a release without roads."""
    source = ReleaseSource(release)
    facts = source.describe()
    if not source.tiles():
        raise FormatError(name, "surfaces, links", "at least one")
    with replaced_file(out) as stream:
        writer = PmtilesWriter(stream)
        for zoom in range(LEAST_ZOOM, ZOOM + 1):
            for number, place, within in _places(source.tiles(), zoom):
                tile = encode_tile(_layers(source, place, within))
                if tile:
                    writer.add(number, tile)
        count = writer.finish(_metadata(facts), zooms=(LEAST_ZOOM, ZOOM), bounds_deg=facts["bounds"])
    return [f"{out}: {count} tiles, zoom {LEAST_ZOOM} to {ZOOM}, positions of {facts['datum']}"]


def _places(tiles: Sequence[Tile], zoom: int) -> Iterator[tuple[int, TilePlace, list[Tile]]]:
    """Tiles at this zoom with their numbers and the release's tiles in each, in the order of their numbers."""
    fine = np.array(tiles, np.int64)
    numbers = hilbert_numbers(ZOOM, *fine.T) >> 2 * (ZOOM - zoom)
    order = np.argsort(numbers, kind="stable")
    begins = np.flatnonzero(np.diff(numbers[order], prepend=-1))
    for rows in np.split(order, begins[1:]):
        x, y = (fine[rows[0]] >> ZOOM - zoom).tolist()
        within = [tiles[row] for row in rows.tolist()]
        yield first_number(zoom) + int(numbers[rows[0]]), TilePlace(zoom, x, y), within


def _layers(source: MapSource, place: TilePlace, within: Sequence[Tile]) -> list[TileLayer]:
    if place.zoom < LINK_ZOOM:
        return [_thinned_links(source, place, within)]
    layers = link_layers(source, within, place)
    if place.zoom >= SURFACE_ZOOM:
        layers += surface_layers(source, within, place, with_height=True)
    return layers


def _thinned_links(source: MapSource, place: TilePlace, within: Sequence[Tile]) -> TileLayer:
    """Pairs of cells that a link connects, each once."""
    pairs = np.zeros((0, 4), np.int64)
    for first in range(0, len(within), _READ_AT_ONCE):
        read = _cell_pairs(source, place, within[first : first + _READ_AT_ONCE])
        pairs = np.unique(np.concatenate([pairs, *read]), axis=0)
    is_line = (pairs[:, :2] != pairs[:, 2:]).any(axis=1)
    # A map within one cell is a mark.
    pairs = pairs[is_line] if is_line.any() else pairs[:1] + np.array((0, 0, 1, 0))
    return TileLayer(
        name="links",
        kind="LineString",
        numbers=np.arange(len(pairs)),
        points=pairs.reshape(-1, 2) * _CELL + _CELL // 2,
        first=np.arange(len(pairs) + 1) * 2,
        properties={"level": np.zeros(len(pairs), np.int64)},
    )


def _cell_pairs(source: MapSource, place: TilePlace, within: Iterable[Tile]) -> Iterator[Int64]:
    """Pairs (n, 4) of cells of successive vertices, the lesser cell first."""
    for tile in within:
        links = source.link_tile(*tile)
        if links is None:
            continue
        shares = world_shares(*link_vertices(links).T) * (1 << place.zoom) - (place.x, place.y)
        cells = np.floor(shares * (EXTENT // _CELL)).astype(np.int64)
        pairs = np.hstack((cells[:-1], cells[1:]))
        is_segment = np.ones(len(pairs), bool)
        is_segment[links.first_vertex[1:-1] - 1] = False
        pairs = pairs[is_segment]
        later = (pairs[:, 0] > pairs[:, 2]) | ((pairs[:, 0] == pairs[:, 2]) & (pairs[:, 1] > pairs[:, 3]))
        yield np.where(later[:, None], pairs[:, (2, 3, 0, 1)], pairs)


def _metadata(facts: dict[str, Any]) -> dict[str, Any]:
    least = {"surfaces": SURFACE_ZOOM, "links": LEAST_ZOOM}
    layers = [
        {"id": layer, "fields": fields, "minzoom": least[layer], "maxzoom": ZOOM}
        for layer, fields in _FIELDS.items()
    ]
    return {
        "name": f"{facts['region']} {facts['version']}",
        "description": f"road surfaces and links, positions of {facts['datum']}",
        "vector_layers": layers,
        "camber": {key: facts[key] for key in ("region", "version", "datum", "surrogate")},
    }
