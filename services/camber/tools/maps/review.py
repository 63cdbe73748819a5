"""`camber map review RELEASES`: changes of the map that wait for a person, and what is decided of them.

RELEASES is map_update's folder of releases. Without a decision it lists what is held, with its numbers. A
decision names who and why; map_update applies it in its next cycle.
"""

from __future__ import annotations

import argparse
import getpass
import os
from collections.abc import Sequence
from pathlib import Path

from camber.map_update.release.review import HeldChange, ReviewAction, ReviewDecision, ReviewFolder
from camber.road_map.road_columns import ReleaseError
from camber.runtime.clock import SystemClock
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import NUMBER
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
    parser.add_argument("--who", default=user_name(), help="who decides (the user's name)")
    parser.add_argument("--why", help="why; must be given with a decision")
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
        for each in review.decisions():
            print(f"{each.surface_id:>12}  {each.action:<6}  {each.offset_m:+8.3f} m  {each.who}: {each.why}")
        return 0
    chosen = args.accept or args.reject
    if chosen is None:
        return "\n".join(_lines(review.held()))
    if not args.why:
        raise ReleaseError("decision", "--why", "the reason")
    action: ReviewAction = "accept" if args.accept else "reject"
    held = {each.surface_id: each for each in review.held()}
    unknown = sorted(set(chosen) - held.keys())
    if unknown:
        raise ReleaseError("decision", "surface", "one that is held", actual=str(unknown[0]))
    decision = {"action": action, "who": args.who, "why": args.why, "time_ns": SystemClock().now_ns()}
    offsets_m = {surface: held[surface].offset_m for surface in chosen}
    review.append(
        [ReviewDecision(surface_id=n, offset_m=offset_m, **decision) for n, offset_m in offsets_m.items()]
    )
    return f"{len(chosen)} changes: {action}; map_update applies it in its next cycle"


def _lines(held: Sequence[HeldChange]) -> list[str]:
    if not held:
        return ["nothing is held"]
    lines = [f"{'surface':>12}  {'map has':>9}  {'votes say':>9}  {'error':>7}  agree  vehicles  days  why"]
    for each in held:
        lines.append(
            f"{each.surface_id:>12}  {each.previous_correction_m:>+7.3f} m  {each.offset_m:>+7.3f} m"
            f"  {each.standard_error_m:>5.3f} m  {each.agreement:>5.2f}  {each.vehicles:>8}  {each.days:>4}"
            f"  {each.reason.replace('_', ' ')}"
        )
    return lines
