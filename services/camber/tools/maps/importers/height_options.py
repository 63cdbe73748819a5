"""Options that say above what the heights of a map are; none of them, and the map does not say it: refused."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from camber.formats.errors import FormatError
from camber.formats.map_exchange.vertical_datum import (
    ELLIPSOIDAL,
    FIELD,
    MAX_UNDULATION_M,
    VerticalDatum,
    constant_undulation,
    vertical_datum,
)
from camber.tools.maps.importers.checks.level_heights import level_sigma_of
from camber.tools.maps.importers.geoid_grid import geoid_grid
from camber.tools.maps.importers.lane_map import LaneSurvey
from camber.tools.options.number_options import HEIGHT_SIGMA, number_from
from camber.tools.options.parsers import add_with_default


def add_height_arguments(parser: argparse.ArgumentParser, *, of_lanes: bool = False) -> None:
    """The vertical datum, or an undulation that the user answers for; σ of the heights, and of lanes across."""
    add = parser.add_argument_group("heights of the input").add_argument
    text = (
        "above what they are: ellipsoidal, or a vertical CRS as PROJ knows it (EPSG:7837, 'EGM2008 height')"
    )
    add("--vertical-datum", metavar="NAME", help=text)
    text = "instead of --vertical-datum: one height of the geoid above the ellipsoid for all of a small map"
    bounds = number_from(-MAX_UNDULATION_M, MAX_UNDULATION_M, "m")
    add("--geoid-undulation-m", type=bounds, metavar="N", help=text)
    add("--geoid-sigma-m", type=HEIGHT_SIGMA, metavar="S", help="its σ, which goes into that of the map")
    add("--geoid-source", metavar="TEXT", help="where it is from; stands in the release")
    text = "instead of --vertical-datum: grid of the geoid that heights are above (.gtx, .tif, .isg, GSIGEO's .asc)"
    add("--geoid", type=Path, metavar="FILE", help=text)
    text = "σ of the heights of roads in the input"
    add("--sigma-m", type=HEIGHT_SIGMA, required=True, metavar="S", help=text)
    if of_lanes:
        bounds = number_from(0.001, 100.0, "m")
        add_with_default(parser, "--link-sigma-m", 0.5, "σ of the lanes across", type=bounds, metavar="S")


def lane_survey(args: argparse.Namespace, vertical: VerticalDatum) -> LaneSurvey:
    """How well the lanes of a map are known."""
    sigma_m = sigma_of(args, vertical)
    return LaneSurvey(
        sigma_m=sigma_m,
        link_sigma_m=args.link_sigma_m,
        seen_ns=args.surveyed_ns,
        level_sigma_m=level_sigma_of(args),
    )


def vertical_of(args: argparse.Namespace, file: str, stated: str | None = None) -> VerticalDatum:
    """What `args` say, or else the map itself (`stated`); FormatError where neither does, or they contradict."""
    constant = (args.geoid_undulation_m, args.geoid_sigma_m, args.geoid_source)
    if args.geoid is not None:
        if any(part is not None for part in (*constant, args.vertical_datum)):
            raise FormatError(file, FIELD, "--geoid without --vertical-datum and --geoid-undulation-m")
        if stated == ELLIPSOIDAL:
            raise FormatError(file, FIELD, "no --geoid for what the file says", actual=stated)
        return geoid_grid(args.geoid, args.datum)
    if any(part is not None for part in constant):
        if any(part is None for part in constant) or args.vertical_datum is not None:
            expected = "all of --geoid-undulation-m, --geoid-sigma-m, --geoid-source without --vertical-datum"
            raise FormatError(file, FIELD, expected)
        try:
            return constant_undulation(*constant)
        except ValueError as error:
            raise FormatError(file, FIELD, str(error)) from None
    named = args.vertical_datum
    if named is not None and stated is not None and named != stated:
        raise FormatError(file, FIELD, f"{stated}, as the file says", actual=named)
    name = named or stated
    if name is None:
        expected = "--vertical-datum with its name (ellipsoidal, EPSG:7837, …)"
        raise FormatError(file, FIELD, expected, actual="not stated")
    return vertical_datum(name, args.datum, file)


def sigma_of(args: argparse.Namespace, vertical: VerticalDatum) -> float:
    """σ of heights in the release [m]: of the input's, and of the conversion."""
    return math.hypot(args.sigma_m, vertical.sigma_m)
