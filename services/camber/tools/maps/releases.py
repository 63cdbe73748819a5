"""`camber map releases PATH`: which releases there are, what became of a surface, and back to an earlier one.

PATH is map_update's folder of releases, or a vehicle's store. Back in the folder: a new release with the corrections of
an earlier one, for the whole fleet. Back in a store: that vehicle alone, to the release before.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from camber.geodesy.gps_time import text_from_calendar, utc_from_gps_ns
from camber.map_update.fusion.correction_rows import NONE
from camber.map_update.fusion.votes import vote_values
from camber.map_update.release.operator_decisions import other_offsets, roll_back
from camber.map_update.release.release_builder import ReleaseBuilder, corrections_of, history, reference_in
from camber.map_update.release.review import ReviewFolder
from camber.road_map.release import load_signing_key
from camber.road_map.release_files import ReleaseFolder
from camber.road_map.road_columns import ReleaseError
from camber.road_map.store import MapStore
from camber.tools.maps.review import decision_of, user_name
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import NUMBER
from camber.tools.options.parsers import tool_parser

_PROG = "camber map releases"


def main(argv: Sequence[str]) -> int:
    """List, explain or go back; 0 done, 2 what was asked cannot be done."""
    parser = tool_parser(_PROG, __doc__)
    parser.add_argument("path", type=Path, metavar="PATH", help="folder of releases, or a vehicle's store")
    choice = parser.add_mutually_exclusive_group()
    for name, metavar, text in (
        ("--why", "SURFACE", "what a surface's height comes from"),
        ("--roll-back", "VERSION", "a new release as VERSION was (folder)"),
        ("--allow-from", "VERSION", "let versions from this on come again (store)"),
    ):
        choice.add_argument(name, type=NUMBER, metavar=metavar, help=text)
    choice.add_argument("--go-back", action="store_true", help="the release before in force again (store)")
    parser.add_argument("--uploads", type=Path, help="with --why: uploads.sqlite, for the votes by pseudonym")
    parser.add_argument("--signing-key", type=Path, help="with --roll-back: the key that signs releases")
    text = "with --roll-back: the operator's key, needed where map_update has operator_keys"
    parser.add_argument("--operator-key", type=Path, metavar="PEM", help=text)
    parser.add_argument("--who", default=user_name(), help="with --roll-back: who does it (the user's name)")
    parser.add_argument("--reason", help="with --roll-back: why; must be given")
    args = parser.parse_args(argv)
    return report_failures(_PROG, args.path, lambda: (_folder if args.path.is_dir() else _store)(args))


def _folder(args: argparse.Namespace) -> int:
    if args.go_back or args.allow_from is not None:
        raise ReleaseError(str(args.path), "path", "a vehicle's store for --go-back and --allow-from")
    if args.roll_back is not None:
        return _roll_back(args)
    if args.why is not None:
        print("\n".join(_why(args.path, args.why, args.uploads)))
        return 0
    source = ReleaseFolder(args.path)
    print(f"{'version':>8}  {'made':<10}  {'corrected':>9}  {'changed':>7}  {'tiles':>6}  {'MB':>8}")
    made = list(history(args.path))
    rows = [corrections_of(source, each.manifest) for each in made]
    for each, corrections, before in zip(made, rows, [*rows[1:], NONE], strict=True):
        manifest = each.manifest
        count = "reference" if manifest.reference_sha256 is None else f"{len(corrections)}"
        changed = len(other_offsets(corrections, before)) + len(other_offsets(before, corrections, gone=True))
        size_mb = int(manifest.size_bytes.sum()) / 1e6
        row = f"{manifest.map_version:>8}  {_day(manifest.time_ns)}  {count:>9}  {changed:>7}"
        print(f"{row}  {len(manifest.layer):>6}  {size_mb:>8.1f}")
    return 0


def _roll_back(args: argparse.Namespace) -> int:
    if args.signing_key is None or not args.reason:
        raise ReleaseError("roll-back", "--signing-key and --reason", "both")
    key = load_signing_key(args.signing_key)
    builder = ReleaseBuilder(args.path, reference_in(args.path), signing_key=key)
    args.why = args.reason
    decision = decision_of(
        args, "roll_back", map_version=args.roll_back, reference_sha256=builder.reference.root.manifest_sha256
    )
    review = ReviewFolder(args.path)
    operators = review.published_operators()
    done = roll_back(review, decision, builder, time_ns=decision.time_ns, operators=operators)
    text = f"version {done.root.map_version} has the corrections of {args.roll_back}"
    print(f"{text}; {done.withdrawn} were withdrawn")
    return 0


def _why(folder: Path, surface_id: int, uploads: Path | None) -> list[str]:
    source = ReleaseFolder(folder)
    lines = [
        f"surface {surface_id}",
        f"{'version':>8}  {'offset':>9}  {'error':>7}  vehicles  last seen   since",
    ]
    for made in history(folder):
        rows = corrections_of(source, made.manifest)
        row = rows[rows["surface_id"] == surface_id]
        if made.manifest.reference_sha256 is None:
            lines.append(f"{made.manifest.map_version:>8}  reference")
        elif len(row):
            day = _day(int(row["last_seen_ns"][0]))
            lines.append(
                f"{made.manifest.map_version:>8}  {row['offset_m'][0]:>+7.3f} m  {row['sigma_m'][0]:>5.3f} m"
                f"  {row['vehicles'][0]:>8}  {day}  {row['since_map_version'][0]}"
            )
        else:
            lines.append(f"{made.manifest.map_version:>8}  as the reference")
    for each in (outcome for line in ReviewFolder(folder).lines() for outcome in line.outcomes()):
        if each.surface_id == surface_id:
            decision = each.decision
            back = "" if decision.map_version is None else f" (back to version {decision.map_version})"
            lines.append(f"{each.action} at {each.offset_m:+.3f} m by {decision.who}: {decision.why}{back}")
    return lines if uploads is None else lines + _votes(uploads, surface_id)


def _votes(uploads: Path, surface_id: int) -> list[str]:
    """The votes on a surface: by pseudonym, which only the holder of the key can trace to a vehicle."""
    from camber.map_update.stores.sqlite_store import SqliteStore
    from camber.map_update.stores.store import StoreError

    if not uploads.is_file():
        raise ReleaseError(str(uploads), "file", "the uploads of map_update")
    try:
        with closing(SqliteStore(uploads, read_only=True)) as store:
            votes = store.votes_of(np.array([surface_id], np.int64))
    except StoreError as error:
        raise ReleaseError(str(uploads), "file", f"the uploads of map_update ({error})") from None
    value_m = vote_values(votes)[0]
    voters = len(np.unique(votes["voter"]))
    lines = [f"{len(votes)} votes of {voters} vehicles", f"{'pseudonym':>16}  {'day':>6}  {'says':>9}"]
    for row, deviation_m in zip(votes, value_m.tolist(), strict=True):
        lines.append(
            f"{int(row['voter']) & (2**64 - 1):016x}  {int(row['session']):>6}  {deviation_m:>+7.3f} m"
        )
    return lines


def _day(time_ns: int) -> str:
    return text_from_calendar(utc_from_gps_ns(time_ns))[:10]


def _store(args: argparse.Namespace) -> int:
    if not args.path.is_file():
        raise ReleaseError(str(args.path), "path", "a folder of releases, or a vehicle's store")
    if args.roll_back is not None or args.why is not None:
        raise ReleaseError(str(args.path), "path", "a folder of releases for --roll-back and --why")
    with closing(MapStore(args.path)) as store:
        if args.go_back:
            kept = store.go_back()
            text = f"version {kept.map_version} is in force again"
            print(f"{text}; the vehicle's map_server takes it within seconds")
            return 0
        if args.allow_from is not None:
            store.allow_from(args.allow_from)
            print(f"versions from {args.allow_from} on may come again")
            return 0
        current, previous = store.current(), store.previous()
        for kept in store.releases():
            state = {"coming": "on its way", "left": "left by the operator", "here": "kept"}[kept.state]
            state = "in force" if kept == current else "before it" if kept == previous else state
            print(f"{kept.map_version:>8}  {kept.region:<16}  {kept.manifest_sha256[:16]}  {state}")
        print(f"highest version accepted: {store.highest()}")
    return 0
