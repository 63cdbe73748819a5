"""`camber map review RELEASES`: changes of the map that wait for a person, and what is decided of them.

RELEASES is map_update's folder of releases. Without a decision it lists what is held, with its numbers, the middle of
the surface and its road: with --roads its name, else the number of the link. With --near the nearest come first, with
their distance. A decision names who and why; map_update applies it in its next cycle.
"""

from __future__ import annotations

import argparse
import getpass
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from camber.geodesy.local_frame import LocalFrame
from camber.map_update.release.operator_decisions import decide
from camber.map_update.release.release_builder import reference_in
from camber.map_update.release.review import HeldChange, RecordLine, ReviewFolder
from camber.road_map.operator_keys import sign_decision
from camber.road_map.release_files import write_file
from camber.road_map.road_columns import ReleaseError
from camber.road_map.signing_keys import load_signing_key
from camber.runtime.clock import SystemClock
from camber.schemas.fleet import MapDecision, ReviewAction
from camber.schemas.refused_field import first_refused
from camber.tools.maps.geojson import degrees, feature_collection, make_feature
from camber.tools.maps.road_names import road_names, road_text
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import LATITUDE, LONGITUDE, NUMBER, each_of
from camber.tools.options.output_check import check_output_file
from camber.tools.options.parsers import tool_parser

_PROG = "camber map review"


def main(argv: Sequence[str]) -> int:
    """List or decide; 0 done, 2 what was asked cannot be done."""
    parser = tool_parser(_PROG, __doc__)
    parser.add_argument("releases", type=Path, metavar="RELEASES", help="map_update's folder of releases")
    choice = parser.add_mutually_exclusive_group()
    for name, text in (("--accept", "publish these changes"), ("--reject", "do not publish these changes")):
        choice.add_argument(name, type=NUMBER, nargs="+", metavar="SURFACE", help=text)
    choice.add_argument("--log", action="store_true", help="show what was decided so far")
    choice.add_argument(
        "--rejected", action="store_true", help="list what --accept can still publish instead"
    )
    choice.add_argument("--pending", action="store_true", help="list what waits for more votes instead")
    text = "list the nearest to this place first [°]"
    nearest = each_of(LATITUDE, LONGITUDE)
    parser.add_argument("--near", action=nearest, nargs=2, metavar=("LAT", "LON"), help=text)
    text = "names of roads: the .geojson or OpenStreetMap file that the map was made along"
    parser.add_argument("--roads", type=Path, metavar="FILE", help=text)
    text = "write the list as points too, with ids as texts"
    parser.add_argument("--geojson", type=Path, metavar="FILE", help=text)
    parser.add_argument("--who", default=user_name(), help="who decides (the user's name)")
    parser.add_argument("--why", help="why; must be given with a decision")
    text = "the operator's Ed25519 key that signs the decision; needed where map_update has operator_keys"
    parser.add_argument("--operator-key", type=Path, metavar="PEM", help=text)
    args = parser.parse_args(argv)
    return report_failures(_PROG, args.releases, lambda: _carry_out(args))


def user_name() -> str:
    """Of whom this process runs as; in a container that may be a number without a name."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # which of them depends on Python's version
        return f"uid {os.getuid()}"


def _carry_out(args: argparse.Namespace) -> int | str:
    if not args.releases.is_dir():
        raise ReleaseError(str(args.releases), "folder", "map_update's folder of releases")
    review = ReviewFolder(args.releases)
    if args.log:
        print("\n".join(map(log_line, review.lines())))
        return 0
    chosen = args.accept or args.reject
    if chosen is None:
        read = review.pending if args.pending else review.rejected if args.rejected else review.held
        return _listed(args, read())
    if not args.why:
        raise ReleaseError("decision", "--why", "the reason")
    listed = {each.surface_id: each for each in (*review.rejected(), *review.held())}
    unknown = sorted(set(chosen) - listed.keys())
    if unknown:
        raise ReleaseError("decision", "surface", "one that is held", actual=str(unknown[0]))
    action: ReviewAction = "accept" if args.accept else "reject"
    reference = reference_in(args.releases).root.manifest_sha256
    decisions = [
        decision_of(
            args, action, reference_sha256=reference, surface_id=number, offset_m=listed[number].offset_m
        )
        for number in dict.fromkeys(chosen)
    ]
    decide(review, decisions, now_ns=SystemClock().now_ns(), operators=review.published_operators())
    return f"{len(chosen)} changes: {action}; map_update applies it in its next cycle"


def decision_of(args: argparse.Namespace, action: ReviewAction, **values: Any) -> MapDecision:
    """A decision by `--who` for `--why`, signed where there is a key."""
    time_ns = SystemClock().now_ns()
    try:
        decision = MapDecision(time_ns=time_ns, action=action, who=args.who, why=args.why, **values)
    except ValidationError as error:
        refused = first_refused(error)
        raise ReleaseError("decision", refused.name, refused.expected) from None
    key = args.operator_key
    return decision if key is None else sign_decision(decision, load_signing_key(key))


def log_line(line: RecordLine) -> str:
    """A decision of the record."""
    decision = line.decision
    what = f"{decision.surface_id:>19}" if decision.surface_id is not None else f"{'':>19}"
    detail = f"{decision.offset_m:+8.3f} m" if decision.offset_m is not None else f"to {decision.map_version}"
    withdrew = f", withdrew {len(line.withdrawn)} changes" if line.withdrawn else ""
    by = f", key {decision.key_id}" if decision.key_id else ""
    return f"{what}  {decision.action:<9}  {detail:<10}  {decision.who}: {decision.why}{withdrew}{by}"


def _listed(args: argparse.Namespace, changes: Sequence[HeldChange]) -> str:
    """The changes as lines, and as a file where one is asked for."""
    names = {} if args.roads is None else road_names(args.roads)
    distances_m = [_distance_m(change, args.near) for change in changes]
    if args.near is not None:
        order = sorted(range(len(changes)), key=lambda at: distances_m[at])
        changes, distances_m = [changes[at] for at in order], [distances_m[at] for at in order]
    if args.geojson is not None:
        check_output_file(args.geojson)
        write_file(args.geojson, _as_geojson(changes, names).encode())
    if not changes:
        return f"nothing is {'pending' if args.pending else 'rejected' if args.rejected else 'held'}"
    head = f"{'surface':>19}  {'latitude':>10}  {'longitude':>11}  {'road':<24}  {'map has':>9}  {'votes say':>9}"
    head = f"{head}  {'error':>7}  agree  vehicles  days  why"
    if args.near is None:
        return "\n".join([head, *(_line(each, names) for each in changes)])
    pairs = zip(distances_m, changes, strict=True)
    return "\n".join(
        [f"{'distance':>10}  {head}", *(f"{m:>8.0f} m  {_line(each, names)}" for m, each in pairs)]
    )


def _distance_m(change: HeldChange, near_deg: tuple[float, float] | None) -> float:
    """Distance from a place, infinite where that of the change is not known: it is listed last."""
    latitude_rad, longitude_rad = change.latitude_rad, change.longitude_rad
    if near_deg is None or latitude_rad is None or longitude_rad is None:
        return math.inf
    # In a straight line: of places on opposite sides of the earth the order is the same.
    latitude_deg, longitude_deg = near_deg
    frame = LocalFrame(math.radians(latitude_deg), math.radians(longitude_deg), 0.0)
    return math.hypot(*frame.enu_from_geodetic(latitude_rad, longitude_rad, 0.0))


def _line(change: HeldChange, names: Mapping[int, str]) -> str:
    place = f"{'not known':>23}"
    if change.latitude_rad is not None and change.longitude_rad is not None:
        latitude, longitude = math.degrees(change.latitude_rad), math.degrees(change.longitude_rad)
        place = f"{latitude:>10.6f}  {longitude:>11.6f}"
    road = road_text(change.link_id, names)
    return (
        f"{change.surface_id:>19}  {place}  {road:<24}  {change.previous_correction_m:>+7.3f} m"
        f"  {change.offset_m:>+7.3f} m  {change.standard_error_m:>5.3f} m  {change.agreement:>5.2f}"
        f"  {change.vehicles:>8}  {change.days:>4}  {change.reason.replace('_', ' ')}"
    )


def _as_geojson(changes: Sequence[HeldChange], names: Mapping[int, str]) -> str:
    """Points of changes whose place is known."""
    features = []
    for change in changes:
        if change.link_id is None or change.latitude_rad is None or change.longitude_rad is None:
            continue
        values = {name: value for name, value in asdict(change).items() if not name.endswith("_rad")}
        ids = {name: str(values[name]) for name in ("surface_id", "link_id")}
        road = {"road": road_text(change.link_id, names)}
        point = [degrees(change.longitude_rad), degrees(change.latitude_rad)]
        features.append(make_feature(ids["surface_id"], "Point", point, values | ids | road))
    return feature_collection(features)
