"""`camber map picture RELEASE --out FILE.png`: a map from above: surfaces by height, links over them, clouds below.

Heights go from blue (lowest) to yellow (highest); a surface of a higher level lies over those of lower ones and has a
dark edge. Without --tile the whole map is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.observations import Floats, Integers
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.release import Release
from camber.road_map.release_files import write_file
from camber.road_map.road_columns import RoadSurfaces
from camber.road_map.tile_grid import Tile, tile_corners_rad
from camber.schemas.road import LAYERS
from camber.tools.localize.map_drawing import draw_clouds, link_lines
from camber.tools.maps.release_at import add_release, named_release
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import whole_from
from camber.tools.options.output_check import check_output_file
from camber.tools.options.parsers import add_with_default, tool_parser
from camber.validation.plots import draw_lines, draw_scale_and_north, plot_style, png_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PROG = "camber map picture"
_LINK, _EDGE = "#cd3c50", "#282c34"
_SCALE = ("#3042a0", "#268caa", "#5ab96e", "#ebd750")
_DPI = 100.0  # chosen: lines of a pixel or two at the usual size
_LEAST_PIXELS = 400  # chosen: in a smaller picture scale, north and legend would hide the map
_MARGIN_M = 5.0  # around the outermost surfaces; chosen: about a lane and a half


def main(argv: Sequence[str]) -> int:
    """Draw one release; 0 done, 2 an error, reported in one line."""
    parser = tool_parser(_PROG, __doc__)
    add_release(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.png")
    number = whole_from(-(2**31), 2**31 - 1)
    parser.add_argument("--tile", type=number, nargs=2, metavar=("X", "Y"), help="only this one")
    add_with_default(parser, "--pixels", 1200, "of the longer side", type=whole_from(16, 20_000))
    args = parser.parse_args(argv)

    def work() -> str:
        check_output_file(args.out, _PROG)
        tile = None if args.tile is None else (args.tile[0], args.tile[1])
        png, summary = picture(named_release(args), str(args.release), tile, args.pixels)
        write_file(args.out, png)
        return f"{args.out}: {summary}"

    return report_failures(_PROG, args.out, work)


def picture(release: Release, name: str, tile: Tile | None, pixels: int) -> tuple[bytes, str]:
    """The PNG of a release, or of one of its tiles, and a line about it. FormatError where there is nothing to draw."""
    tiles = sorted({xy for layer in LAYERS for xy in release.tiles(layer)})
    if not tiles or (tile is not None and tile not in tiles):
        expected = "one of the release's" if tiles else "at least one"
        raise FormatError(name, "tiles", expected, actual=str(tile))
    surfaces = release.road_surfaces()
    frame, low_m, high_m = _extent(surfaces, tiles if tile is None else [tile], tile is None)
    with plot_style():
        figure, axes = _new_figure(low_m, high_m, pixels)
        draw_clouds(axes, release, frame)
        drawn, lowest_m, highest_m = _draw_surfaces(axes, surfaces, frame)
        draw_lines(axes, link_lines(release, frame, axes), _LINK, 0.8, antialiased=False)
        if pixels >= _LEAST_PIXELS:
            draw_scale_and_north(axes)
            _draw_legend(axes, lowest_m, highest_m, surfaces=drawn)
        png = png_bytes(figure, _DPI, software=_PROG)
    heights = f", heights {lowest_m:.1f} to {highest_m:.1f} m" if drawn else ""
    return png, f"{high_m[0] - low_m[0]:.0f} × {high_m[1] - low_m[1]:.0f} m, {drawn} surfaces{heights}"


def _extent(surfaces: RoadSurfaces, tiles: list[Tile], whole: bool) -> tuple[LocalFrame, Floats, Floats]:
    """The plane of the picture, and its lower left and upper right corner [m]."""
    corners = np.array([tile_corners_rad(*tile) for tile in tiles])
    south, west = corners[:, :2].min(axis=0)
    north, east = corners[:, 2:].max(axis=0)
    frame = LocalFrame(0.5 * float(south + north), 0.5 * float(west + east), 0.0)
    if whole and len(surfaces):
        centre_m = _centres_m(surfaces, frame)
        radius_m = np.hypot(surfaces.half_length_m, surfaces.half_width_m)[:, None] + _MARGIN_M
        return frame, (centre_m - radius_m).min(axis=0), (centre_m + radius_m).max(axis=0)
    low_m, high_m = frame.east_north_from_geodetic_array(
        np.array([south, north]), np.array([west, east]), np.zeros(2)
    )
    return frame, low_m, high_m


def _new_figure(low_m: Floats, high_m: Floats, pixels: int) -> tuple[Figure, Axes]:
    """A figure with axes that fill it, whose longer side has so many pixels, with one scale for both directions."""
    from matplotlib.figure import Figure

    size_m = high_m - low_m
    width, height = np.maximum(np.round(size_m / size_m.max() * pixels), 1.0).tolist()
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.axis("off")
    axes.set(xlim=(low_m[0], high_m[0]), ylim=(low_m[1], high_m[1]))
    return figure, axes


def _draw_legend(axes: Axes, lowest_m: float, highest_m: float, *, surfaces: int) -> None:
    """What lines and colours are, at the lower right."""
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.lines import Line2D

    lines = {"link": (_LINK, 0.8), "edge of a higher level": (_EDGE, 1.0)}
    marks = [Line2D([], [], color=colour, lw=width) for colour, width in lines.values()]
    axes.legend(
        marks, list(lines), loc="lower right", frameon=True, framealpha=0.8, bbox_to_anchor=(1.0, 0.1)
    )
    if not surfaces:
        return
    bar = axes.inset_axes((0.72, 0.025, 0.26, 0.02))
    bar.imshow(
        np.linspace(0.0, 1.0, 256)[None],
        aspect="auto",
        cmap=LinearSegmentedColormap.from_list("height", _SCALE),
        extent=(0.0, 1.0, 0.0, 1.0),
    )
    bar.set(xticks=[], yticks=[])
    bar.set_title(f"height {lowest_m:.1f} to {highest_m:.1f} m", backgroundcolor="white")


def _draw_surfaces(axes: Axes, surfaces: RoadSurfaces, frame: LocalFrame) -> tuple[int, float, float]:
    """Draw the surfaces within the axes, lower decks first; returns how many, and their lowest and highest height."""
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.tri import Triangulation

    centre_m = _centres_m(surfaces, frame)
    radius_m = np.hypot(surfaces.half_length_m, surfaces.half_width_m)[:, None]
    low_m, high_m = np.array([axes.get_xlim(), axes.get_ylim()]).T
    shown = np.flatnonzero((centre_m + radius_m > low_m).all(1) & (centre_m - radius_m < high_m).all(1))
    if not len(shown):
        return 0, 0.0, 0.0
    mean_m = np.array([float(np.mean(surfaces.heights_m[row])) for row in shown.tolist()])
    lowest_m, highest_m = float(mean_m.min()), float(mean_m.max())
    colours = LinearSegmentedColormap.from_list("height", _SCALE)
    ordered = shown[np.lexsort((mean_m, surfaces.level[shown]))]
    for level in np.unique(surfaces.level[ordered]).tolist():
        rows = ordered[surfaces.level[ordered] == level].tolist()
        meshes = [_mesh(surfaces, row, centre_m[row], frame) for row in rows]
        first = np.cumsum([0, *(len(mesh.points_m) for mesh in meshes)])
        points_m = np.concatenate([mesh.points_m for mesh in meshes])
        heights_m = np.concatenate([mesh.heights_m for mesh in meshes])
        triangles = np.concatenate([mesh.triangles + n for mesh, n in zip(meshes, first[:-1], strict=True)])
        axes.tripcolor(
            Triangulation(points_m[:, 0], points_m[:, 1], triangles), heights_m, shading="gouraud", cmap=colours,
            vmin=lowest_m, vmax=max(highest_m, lowest_m + 1e-3),
        )  # fmt: skip
        if level > 0:
            draw_lines(axes, [side for mesh in meshes for side in mesh.sides_m], _EDGE, 1.0)
    return len(shown), lowest_m, highest_m


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Mesh:
    """A surface's grid as triangles: points (n, 2), their heights (n,), rows of triangles (k, 3), its long sides."""

    points_m: Floats
    heights_m: Floats
    triangles: Integers
    sides_m: tuple[Floats, Floats]


def _mesh(surfaces: RoadSurfaces, row: int, centre_m: Floats, frame: LocalFrame) -> _Mesh:
    heights_m = surfaces.heights_m[row]
    half_m = float(surfaces.half_length_m[row]), float(surfaces.half_width_m[row])
    sides = [np.linspace(-half, half, n) for half, n in zip(half_m, heights_m.shape, strict=True)]
    along, across = np.meshgrid(*sides, indexing="ij")
    convergence_rad = (surfaces.longitude_rad[row] - frame.longitude_rad) * np.sin(frame.latitude_rad)
    yaw_rad = surfaces.yaw_rad[row] + convergence_rad
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    points_m = centre_m + np.stack((cos * along - sin * across, sin * along + cos * across), axis=-1)
    index = np.arange(heights_m.size).reshape(heights_m.shape)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    return _Mesh(
        points_m=points_m.reshape(-1, 2),
        heights_m=heights_m.ravel(),
        triangles=np.concatenate((np.column_stack((a, b, c)), np.column_stack((a, c, d)))),
        sides_m=(points_m[:, 0], points_m[:, -1]),
    )


def _centres_m(surfaces: RoadSurfaces, frame: LocalFrame) -> Floats:
    return frame.east_north_from_geodetic_array(
        surfaces.latitude_rad, surfaces.longitude_rad, np.zeros(len(surfaces))
    )
