"""`camber map picture RELEASE --out FILE.png`: a map from above: surfaces by height, links over them, clouds below.

Heights go from blue (lowest) to yellow (highest); a surface of a higher level lies over those of lower ones and has a
dark edge. Without --tile the whole map is drawn.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camber.formats.errors import FormatError
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.release import Release, load_public_key, read_release
from camber.road_map.release_files import write_file
from camber.road_map.road_columns import RoadSurfaces
from camber.road_map.tile_grid import Tile, tile_corners_rad
from camber.schemas.road import LAYERS
from camber.tools.localize.map_drawing import cloud_raster, plane_links
from camber.tools.maps.importers.surfaces_along import Floats, Integers
from camber.tools.options.error_report import in_words
from camber.tools.options.number_options import whole_from
from camber.validation.plot_frame import Panel
from camber.validation.raster import Colours, Raster

_PROG = "camber map picture"
_LINK = np.array([205, 60, 80], np.uint8)
_EDGE = np.array([40, 44, 52], np.uint8)
_SCALE = np.array([(48, 66, 160), (38, 140, 170), (90, 185, 110), (235, 215, 80)], np.float64)


def main(argv: Sequence[str]) -> int:
    """Draw one release; 0 done, 2 something is not as it must be, said in one line."""
    parser = argparse.ArgumentParser(prog=_PROG, description=__doc__)
    parser.add_argument("release", type=Path, metavar="RELEASE", help="folder of a release")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.png")
    parser.add_argument(
        "--tile", type=whole_from(-(2**31), 2**31 - 1), nargs=2, metavar=("X", "Y"), help="only this one"
    )
    parser.add_argument(
        "--pixels",
        type=whole_from(16, 20_000),
        default=1200,
        help="of the longer side (default: %(default)s)",
    )
    parser.add_argument("--public-key", type=Path, metavar="PEM", help="of who must have signed it")
    args = parser.parse_args(argv)
    return in_words(_PROG, args.out, lambda: _draw(args))


def _draw(args: argparse.Namespace) -> int:
    key = None if args.public_key is None else load_public_key(args.public_key)
    release = read_release(args.release, public_key=key)
    tile = None if args.tile is None else (args.tile[0], args.tile[1])
    png, said = picture(release, str(args.release), tile, args.pixels)
    write_file(args.out, png)
    print(f"{args.out}: {said}")
    return 0


def picture(release: Release, name: str, tile: Tile | None, pixels: int) -> tuple[bytes, str]:
    """The PNG of a release, or of one of its tiles, and a line about it. FormatError where there is nothing to draw."""
    tiles = sorted({xy for layer in LAYERS for xy in release.tiles(layer)})
    if not tiles or (tile is not None and tile not in tiles):
        raise FormatError(
            name, "tiles", "one of the release's" if tiles else "at least one", actual=str(tile)
        )
    surfaces = release.road_surfaces()
    frame, panel = _panel(surfaces, tiles if tile is None else [tile], tile is None, pixels)
    raster = cloud_raster(release, frame, panel)
    drawn, low_m, high_m = _paint_surfaces(raster, surfaces, frame, panel)
    for line in plane_links(release, frame, panel):
        _paint_line(raster, line, panel, _LINK)
    heights = f", heights {low_m:.1f} to {high_m:.1f} m" if drawn else ""
    size = f"{panel.x[1] - panel.x[0]:.0f} × {panel.y[1] - panel.y[0]:.0f} m"
    return raster.png(), f"{size}, {drawn} surfaces{heights}"


def _panel(surfaces: RoadSurfaces, tiles: list[Tile], whole: bool, pixels: int) -> tuple[LocalFrame, Panel]:
    """What the picture shows: one scale for both directions."""
    corners = np.array([tile_corners_rad(*tile) for tile in tiles])
    south, west = corners[:, :2].min(axis=0)
    north, east = corners[:, 2:].max(axis=0)
    frame = LocalFrame(0.5 * float(south + north), 0.5 * float(west + east), 0.0)
    if whole and len(surfaces):
        places = frame.east_north_from_geodetic_array(
            surfaces.latitude_rad, surfaces.longitude_rad, 0.0 * surfaces.latitude_rad
        )
        reach = np.hypot(surfaces.half_length_m, surfaces.half_width_m)[:, None] + 5.0
        low, high = (places - reach).min(axis=0), (places + reach).max(axis=0)
    else:
        box = frame.east_north_from_geodetic_array(
            np.array([south, north]), np.array([west, east]), np.zeros(2)
        )
        low, high = box
    m_a_pixel = float((high - low).max()) / pixels
    width, height = np.maximum(np.round((high - low) / m_a_pixel), 1.0).tolist()
    return frame, Panel(0.0, height, (low[0], high[0]), (low[1], high[1]), "", left=0.0, width=width)


def _paint_surfaces(
    raster: Raster, surfaces: RoadSurfaces, frame: LocalFrame, panel: Panel
) -> tuple[int, float, float]:
    """Paint those within the panel, lower levels first; how many, and their lowest and highest height."""
    places = frame.east_north_from_geodetic_array(
        surfaces.latitude_rad, surfaces.longitude_rad, 0.0 * surfaces.latitude_rad
    )
    reach = np.hypot(surfaces.half_length_m, surfaces.half_width_m)
    low, high = np.array([panel.x[0], panel.y[0]]), np.array([panel.x[1], panel.y[1]])
    shown = np.flatnonzero((places + reach[:, None] > low).all(1) & (places - reach[:, None] < high).all(1))
    if not len(shown):
        return 0, 0.0, 0.0
    middle_m = np.array([float(np.mean(surfaces.heights_m[row])) for row in shown.tolist()])
    low_m, high_m = float(middle_m.min()), float(middle_m.max())
    turn = (surfaces.longitude_rad - frame.longitude_rad) * np.sin(frame.latitude_rad)
    step_m = 0.5 * (panel.x[1] - panel.x[0]) / panel.width
    for row in shown[np.lexsort((middle_m, surfaces.level[shown]))].tolist():
        _paint_surface(raster, surfaces, row, places[row], float(surfaces.yaw_rad[row] + turn[row]), step_m, panel,
                       (low_m, max(high_m - low_m, 1e-3)))  # fmt: skip
    return len(shown), low_m, high_m


def _paint_surface(
    raster: Raster,
    surfaces: RoadSurfaces,
    row: int,
    centre_m: Floats,
    yaw_rad: float,
    step_m: float,
    panel: Panel,
    scale: tuple[float, float],
) -> None:
    """Dots as near to one another as half a pixel, by the grid's heights; at most some thousands a side."""
    half = float(surfaces.half_length_m[row]), float(surfaces.half_width_m[row])
    counts = [int(min(2.0 * side / step_m, 4000.0)) + 2 for side in half]
    p, q = (a.ravel() for a in np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in counts), indexing="ij"))
    height_m = _bilinear(surfaces.heights_m[row], p, q)
    u, v = (2.0 * p - 1.0) * half[0], (2.0 * q - 1.0) * half[1]
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    colours = _colours((height_m - scale[0]) / scale[1])
    if surfaces.level[row] > 0:
        edge = np.abs(v) > half[1] - 2.0 * step_m
        colours[edge] = _EDGE
    x, y = centre_m[0] + c * u - s * v, centre_m[1] + s * u + c * v
    raster.dots(panel.across(x), panel.down(y), colours)


def _bilinear(grid_m: Floats, p: Floats, q: Floats) -> Floats:
    """Heights at shares along and across of a surface's grid."""
    rows, columns = grid_m.shape
    i = np.minimum((p * (rows - 1)).astype(np.int64), rows - 2)
    j = np.minimum((q * (columns - 1)).astype(np.int64), columns - 2)
    a, b = p * (rows - 1) - i, q * (columns - 1) - j
    lower = (1.0 - b) * grid_m[i, j] + b * grid_m[i, j + 1]
    upper = (1.0 - b) * grid_m[i + 1, j] + b * grid_m[i + 1, j + 1]
    heights: Floats = (1.0 - a) * lower + a * upper
    return heights


def _colours(share: Floats) -> Colours:
    at = np.clip(share, 0.0, 1.0) * (len(_SCALE) - 1)
    stops: Integers = np.arange(len(_SCALE))
    return np.column_stack([np.interp(at, stops, _SCALE[:, k]) for k in range(3)]).astype(np.uint8)


def _paint_line(raster: Raster, line_m: Floats, panel: Panel, colour: Colours) -> None:
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(line_m, axis=0).T)))
    count = int(min(2.0 * along[-1] * panel.width / (panel.x[1] - panel.x[0]), 100_000.0)) + 2
    at = np.linspace(0.0, along[-1], count)
    x, y = (np.interp(at, along, line_m[:, axis]) for axis in (0, 1))
    raster.dots(panel.across(x), panel.down(y), colour)
