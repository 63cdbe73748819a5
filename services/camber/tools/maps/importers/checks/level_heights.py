"""Heights that nobody measured: a map whose roads are level is flat because its heights are missing.

Roads are built to drain: their resultant slope is at least 0.5 % nearly everywhere (AASHTO Green Book, 7th edition,
3.4.2 and 4.2.2; RAS-Ew 2005), by crossfall where not along. In recorded maps (a circuit, two districts of a town) 99 %
of the area has more than 0.3 %. So a surface with less than 0.1 % is level, and a lane that mostly is has no heights.
"""

from __future__ import annotations

import argparse

import numpy as np

from camber.formats.errors import FormatError
from camber.road_map.road_columns import RoadSurfaces
from camber.tools.maps.importers.lane_pieces import LanePiece
from camber.tools.maps.importers.lanes import Floats
from camber.tools.options.number_options import number_from
from camber.tools.options.parsers import add_with_default

_LEAST_SLOPE = (
    1e-3  # chosen: a fifth of what roads are built with, a third of what the flattest percent of maps has
)
_SHORTEST_M = (
    10.0  # chosen: along which 0.5 % are 5 cm; a shorter lane may be level where the slope changes its sign
)
_SIGMA_M = 10.0  # chosen: of roads in a town of which only the mean height is known
EXPECTED = "a road's, which has slopes, or --flat for a map without heights"


def add_flat_arguments(parser: argparse.ArgumentParser) -> None:
    """What to do with a map without heights."""
    text = "take level roads, which are invalid otherwise; their σ says so"
    parser.add_argument("--flat", action="store_true", help=text)
    text = "σ of level roads; a small one only for a simulated world that is flat"
    bounds = number_from(0.001, 1000.0, "m")
    add_with_default(parser, "--flat-sigma-m", _SIGMA_M, text, type=bounds, metavar="S")


def level_sigma_of(args: argparse.Namespace) -> float | None:
    """σ of level roads [m], None where they are not taken."""
    return args.flat_sigma_m if args.flat else None


def flat_surrogate(args: argparse.Namespace, surrogate: str) -> str:
    """What the release says of its heights, with what --flat adds."""
    if not args.flat:
        return surrogate
    return "; ".join(filter(None, (surrogate, f"level roads have no heights, σ {args.flat_sigma_m:g} m")))


def is_level_lane(pieces: list[LanePiece]) -> bool:
    """Return whether more than half of a lane's area is level."""
    half_m = np.array([(piece.half_length_m, piece.half_width_m) for piece in pieces])
    if 2.0 * half_m[:, 0].sum() < _SHORTEST_M:
        return False
    rise_m = np.array([np.ptp(piece.heights_m) for piece in pieces])
    return _level_share(rise_m, half_m[:, 0], half_m[:, 1]) > 0.5


def check_raster_slopes(surfaces: RoadSurfaces, file: str) -> None:
    """Refuse surfaces of which more than half of the area is level: FormatError."""
    rise_m = np.array([np.ptp(grid) for grid in surfaces.heights_m])
    share = _level_share(rise_m, surfaces.half_length_m, surfaces.half_width_m)
    if share > 0.5:
        raise FormatError(file, "heights", EXPECTED, actual=f"level on {100.0 * share:.0f} % of the roads")


def _level_share(rise_m: Floats, half_length_m: Floats, half_width_m: Floats) -> float:
    area = half_length_m * half_width_m
    return float(area[rise_m < _LEAST_SLOPE * 2.0 * half_length_m].sum() / area.sum())
