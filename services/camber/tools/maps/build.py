"""`camber map build KIND`: a release of the map from what people have."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Sequence
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

from camber.geodesy.gps_time import CalendarTime, gps_ns_from_utc
from camber.road_map.release import ROOT_NAME, load_signing_key, open_release, write_release
from camber.road_map.road_columns import ReleaseError
from camber.runtime.clock import SystemClock
from camber.tools.maps.importers.built_map import BuiltMap
from camber.tools.maps.importers.lane_map import lineage
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import number_from, whole_from
from camber.tools.options.parsers import tool_parser
from camber.tools.options.subcommands import Command, choose_command

_PROG = "camber map build"

KINDS = {
    "lanelet2": Command("camber.tools.maps.importers.lanelets", "a Lanelet2 map, .osm with `ele`"),
    "opendrive": Command("camber.tools.maps.importers.opendrive_roads", "an OpenDRIVE map, .xodr"),
    "argoverse": Command(
        "camber.tools.maps.importers.argoverse", "an Argoverse 2 log: ground raster and lanes"
    ),
    "clouds": Command("camber.tools.maps.importers.clouds", "LAS, LAZ, PCD or PLY clouds and a trajectory"),
    "drive": Command(
        "camber.tools.maps.importers.survey_drive", "confirmed positions of a replay or a truth.csv"
    ),
    "geojson": Command("camber.tools.maps.geojson_map", "GeoJSON as `camber map export` writes it"),
    "geotiff": Command("camber.tools.maps.importers.rasters", "heights of a raster along given roads"),
}
"""Name → module and a line of help. The module has `add_arguments(parser)` for what only it needs, and
`build(args) -> BuiltMap`, which may raise FormatError and OSError; its docstring describes the command. Of the
arguments that all have, `args` has `datum`, `epoch_year` and `surveyed_ns` (GPS time of the newest evidence)."""


def main(argv: Sequence[str]) -> int:
    """Build one release; 0 done, 2 an error, reported in one line."""
    kind = choose_command(_PROG, KINDS, argv)
    if kind is None:
        return 2
    module = importlib.import_module(KINDS[kind].module)
    parser = _parser(f"{_PROG} {kind}", module.__doc__)
    module.add_arguments(parser)
    args = parser.parse_args(argv[1:])
    return report_failures(f"{_PROG} {kind}", args.out, lambda: _build(args, module.build))


def _build(args: argparse.Namespace, build: Callable[[argparse.Namespace], BuiltMap]) -> int:
    previous = None if args.previous is None else open_release(args.previous)
    if previous is None and (args.out / ROOT_NAME).exists():
        expected = "one without a release, or --previous with the one before"
        raise ReleaseError(str(args.out), "folder", expected)
    key = None if args.signing_key is None else load_signing_key(args.signing_key)
    day: date = args.surveyed or _day_of(args.epoch_year)
    args.surveyed_ns = gps_ns_from_utc(CalendarTime(*day.timetuple()[:6]))
    built: BuiltMap = build(args)
    for remark in built.remarks:
        print(remark)
    before = 0 if previous is None else previous.root.map_version
    root = write_release(
        args.out,
        region=args.region,
        map_version=before + 1 if args.map_version is None else args.map_version,
        datum=args.datum,
        epoch_year=args.epoch_year,
        time_ns=SystemClock().now_ns(),
        surfaces=built.surfaces,
        links=built.links,
        clouds=built.clouds,
        lineage=lineage(built.surfaces, previous),
        surrogate=built.surrogate,
        previous=None if previous is None else previous.root,
        signing_key=key,
    )
    signed = "unsigned" if root.key_id is None else f"signed by {root.key_id}"
    print(
        f"{args.out}: region {root.region}, version {root.map_version}, {signed}: "
        f"{len(built.surfaces)} surfaces, {len(built.links)} links, {len(built.clouds)} tiles of clouds"
    )
    return 0


def _day_of(epoch_year: float) -> date:
    year = int(epoch_year)
    return date(year, 1, 1) + timedelta(days=int((epoch_year - year) * 365.0))


def _parser(prog: str, description: str | None) -> argparse.ArgumentParser:
    parser = tool_parser(prog, description)
    add = parser.add_argument
    add("--out", type=Path, required=True, metavar="DIR", help="folder of the release")
    add("--region", required=True, help="name of the region that the map is of")
    text = "of the positions and ellipsoidal heights of the release, as receivers name it: WGS84, ITRF2020, …"
    add("--datum", required=True, help=text)
    year, text = number_from(1980.1, datetime.now(UTC).year + 1.0), "at which the datum's positions hold"
    add("--epoch-year", type=year, required=True, metavar="YEAR", help=text)
    text = "when the road was last seen; else the day of --epoch-year"
    add("--surveyed", type=date.fromisoformat, metavar="YYYY-MM-DD", help=text)
    text = "else the previous release's and one, or 1"
    add("--map-version", type=whole_from(1, 2**63 - 1), help=text)
    add("--previous", type=Path, metavar="DIR", help="the release that this one comes after")
    add("--signing-key", type=Path, metavar="PEM", help="Ed25519; else the release is unsigned")
    return parser
