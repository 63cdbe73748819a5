"""`camber localize`: run the localizer alone on a recorded drive; writes tables, a plot and match pictures."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_args

from camber.localizer.matching.match_view import MatchView
from camber.localizer.matching.scan_matcher import ScanMatcher
from camber.replay.drive_inputs import prepare_drive
from camber.schemas.drive import DriveManifest, load_manifest
from camber.schemas.pose import ScanMatch
from camber.tools.localize.drive_anchors import Anchors, anchors_of, receiver_fixes
from camber.tools.localize.drive_plot import drive_figure
from camber.tools.localize.local_map_queries import LocalMapQueries
from camber.tools.localize.localizer_run import drive_map, localize, localizer_settings
from camber.tools.localize.match_picture import match_figure
from camber.tools.localize.results import drive_summary, matches_csv, poses_csv
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import number_from
from camber.tools.options.output_check import check_output_folder
from camber.tools.options.parsers import add_drive, tool_parser
from camber.validation.localization_columns import MatchColumns, PoseColumns, PoseErrors
from camber.validation.plots import require_matplotlib, svg_text

_PROG = "camber localize"
_NEAR_NS = 500_000_000
"""Chosen: the largest distance in time between a requested picture and the match drawn."""
_BADNESS = {"converged": 0, "ambiguous": 1, "lost": 2}


def main(argv: Sequence[str]) -> int:
    """Localize one drive; 0 success, 2 the drive cannot be used, 130 interrupted."""
    args, further = _parser().parse_known_args(argv)
    options = {"anchors": args.anchors, "fixes": args.fixes, "pictures_s": args.picture, "quiet": args.quiet}

    def work() -> str:
        manifest = load_manifest(args.drive, args.set)
        check_output_folder(args.out, "poses.csv", "work")
        return localize_drive(manifest, args.out, settings=further, **options)

    return report_failures(_PROG, args.out, work)


def localize_drive(
    manifest: DriveManifest,
    out: Path,
    *,
    anchors: Anchors = "none",
    fixes: bool = False,
    pictures_s: Sequence[float] = (),
    settings: Sequence[str] = (),
    quiet: bool = True,
) -> str:
    """Write poses.csv, matches.csv, localize.svg and pictures into a folder; returns a summary.

    `anchors` and `fixes` are optional inputs of the localizer; `pictures_s` the matches to draw, in seconds after the
    start; `settings` further ones, in the form of the service's command line.

    Raises ManifestError where the drive lacks inputs, ConfigError, FormatError, OSError.
    """
    require_matplotlib()
    out.mkdir(parents=True, exist_ok=True)
    inputs = prepare_drive(manifest, out / "work")
    used = localizer_settings(inputs, out, prog=_PROG, further=settings)
    no_sweeps = (
        "table sweeps with sweeps in it, expected one, or --no-match-sweeps for motion and links alone"
    )
    starts = used.initial_pose is not None or fixes or anchors != "none"
    release = drive_map(
        inputs,
        (inputs.sweeps or not used.match_sweeps, no_sweeps),
        (starts, "initial_pose, expected one, or --fixes or --anchors to start from"),
    )
    views = _MatchViews(start_ns=inputs.tick_times_ns[0], requested_s=pictures_s)
    drive = localize(
        inputs,
        used.options(used.initial_pose),
        LocalMapQueries(release),
        fixes=receiver_fixes(inputs) if fixes else (),
        anchors=anchors_of(inputs, anchors),
        on_matches=views.on_matches,
        quiet=quiet,
    )
    poses, matches = PoseColumns.from_poses(drive.poses), MatchColumns.from_matches(drive.matches)
    errors = None if inputs.truth is None else PoseErrors.from_truth(poses, inputs.truth)
    figure = drive_figure(
        manifest.name, poses=poses, matches=matches, errors=errors, truth=inputs.truth, release=release
    )
    texts = {"poses.csv": poses_csv(drive.poses, errors), "matches.csv": matches_csv(drive.matches)}
    texts["localize.svg"] = svg_text(figure)
    for file, view in views.pictures().items():
        texts[file] = svg_text(match_figure(manifest.name, view, start_ns=views.start_ns))
    for file, text in texts.items():
        (out / file).write_text(text, "utf-8")
    surrogates = list(manifest.surrogate_notes())
    if anchors != "none":
        surrogates.append(f"anchors from {anchors}: an integrity judge without errors")
    summary = drive_summary(
        manifest.name, drive, poses=poses, matches=matches, errors=errors, surrogates=surrogates
    )
    written = f"Written: {', '.join(str(out / file) for file in texts)}."
    return "\n".join([summary, written, *views.missed(), *drive.notes])


@dataclass(slots=True, kw_only=True)
class _MatchViews:
    """Collects the views of the matches to draw: those requested, and the worst."""

    start_ns: int
    requested_s: Sequence[float]
    requested: dict[float, MatchView] = field(default_factory=dict)
    worst: MatchView | None = None
    _least: tuple[int, float] = (-1, 0.0)

    def on_matches(self, matches: Sequence[ScanMatch], matcher: ScanMatcher) -> None:
        """Keep the view of the last match where it will be drawn."""
        match = matches[-1]
        badness = (_BADNESS[match.status], -(0.0 if match.overlap is None else match.overlap))
        nearest = [at_s for at_s in self.requested_s if self._is_nearer(at_s, match.time_ns)]
        if badness <= self._least and not nearest:
            return
        view = matcher.last_view
        if view is None or view.time_ns != match.time_ns:
            return
        self.requested |= dict.fromkeys(nearest, view)
        if badness > self._least:
            self._least, self.worst = badness, view

    def pictures(self) -> dict[str, MatchView]:
        """Return the views to draw by file name."""
        worst = {} if self.worst is None else {"match-worst.svg": self.worst}
        return worst | {f"match-{at_s:g}s.svg": view for at_s, view in self.requested.items()}

    def missed(self) -> list[str]:
        """Return a line for each requested picture that could not be drawn."""
        missed = [at_s for at_s in self.requested_s if at_s not in self.requested]
        return [f"No picture at {at_s:g} s: nothing was matched there." for at_s in missed]

    def _is_nearer(self, at_s: float, time_ns: int) -> bool:
        wanted_ns = self.start_ns + round(at_s * 1e9)
        before = self.requested.get(at_s)
        least_ns = _NEAR_NS if before is None else abs(before.time_ns - wanted_ns)
        return abs(time_ns - wanted_ns) < least_ns


def _parser() -> argparse.ArgumentParser:
    settings = (
        "Settings of the localizer are accepted too, such as --no-match-sweeps for motion and links alone."
    )
    parser = tool_parser(_PROG, __doc__, settings, allow_abbrev=False)
    add_drive(parser, "manifest with motion, sweeps and a map", out="out/localize")
    add, seconds = parser.add_argument, number_from(0.0, 1e6, "s")
    text = "confirmed positions: none, the truth once a second, or the receiver's fixes that agree with the truth"
    add("--anchors", choices=get_args(Anchors), default="none", help=text)
    add("--fixes", action="store_true", help="let the receiver's unconfirmed fixes initialize the pose")
    text = "draw the match nearest to S seconds after the start; repeatable"
    add("--picture", type=seconds, action="append", default=[], metavar="S", help=text)
    add("--quiet", action="store_true", help="no progress bar")
    return parser
