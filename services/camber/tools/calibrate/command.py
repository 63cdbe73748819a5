"""`camber calibrate`: estimate lever arm, antenna height and base-station offset of a vehicle from a recorded drive."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from camber.integrity.learning.common_offset import CommonOffset
from camber.replay.drive_inputs import DriveInputs, prepare_drive
from camber.schemas.drive import DriveManifest, ManifestError, load_manifest
from camber.schemas.motion import LeverArm
from camber.tools.calibrate.calibration import (
    CalibrationData,
    HorizontalCalibration,
    calibrate_horizontal,
    estimate_antenna_height,
    pair,
)
from camber.tools.localize.drive_anchors import receiver_fixes
from camber.tools.localize.local_map_queries import LocalMapQueries
from camber.tools.localize.localizer_run import drive_map, localize, localizer_settings
from camber.tools.options.error_report import report_failures
from camber.tools.options.output_check import check_output_file
from camber.tools.options.parsers import add_drive, tool_parser

_PROG = "camber calibrate"
_LOAD_SIGMA_M = 0.01  # chosen: load and tyres move an antenna by about this from drive to drive


def main(argv: Sequence[str]) -> int:
    """Calibrate from one drive; 0 success, 2 the drive cannot be used, 130 interrupted."""
    args = _parser().parse_args(argv)

    def work() -> str:
        if args.out is not None:
            check_output_file(args.out, _PROG)
        summary, snippet = calibrate(load_manifest(args.drive, args.set), quiet=args.quiet)
        if args.out is None:
            return f"{summary}\n\n{snippet.rstrip()}"
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(snippet, "utf-8")
        return f"{summary}\nWritten: {args.out}."

    return report_failures(_PROG, args.out or args.drive, work)


def calibrate(manifest: DriveManifest, *, quiet: bool = True) -> tuple[str, str]:
    """Return a summary of the calibration, and TOML for the manifest.

    Raises ManifestError where the drive lacks inputs or has too few of them, ConfigError, FormatError, OSError.
    """
    with TemporaryDirectory(prefix="camber-calibrate-") as folder:
        work = Path(folder)
        data = _calibration_data(prepare_drive(manifest, work / "work"), work, quiet=quiet)
    horizontal, height = calibrate_horizontal(data.pairs), estimate_antenna_height(data.cells)
    arm = manifest.lever_arms.antenna
    counts = (
        f"{manifest.name}: {data.fixes:,} fixes, {len(data.pairs.time_ns):,} with a scan match, "
        f"{len(data.cells):,} stretches of known road"
    )
    if horizontal is None and height is None:
        raise ManifestError(f"{counts}, expected some minutes of either")
    lines = [f"{counts}.", *_horizontal_lines(horizontal, arm), *_height_lines(height, arm)]
    return "\n".join(lines), _snippet(manifest.name, horizontal, height, arm)


def _calibration_data(inputs: DriveInputs, work: Path, *, quiet: bool) -> CalibrationData:
    """Pair the fixes with poses of a localizer that does not receive them."""
    fixes = receiver_fixes(inputs)
    no_start = "initial_pose, expected one: poses must be independent of the fixes"
    release = drive_map(inputs, (inputs.initial_pose, no_start))
    settings = localizer_settings(inputs, work, prog=_PROG)
    drive = localize(inputs, settings.options(settings.initial_pose), LocalMapQueries(release), quiet=quiet)
    return pair(fixes, drive.poses)


def _horizontal_lines(result: HorizontalCalibration | None, arm: LeverArm) -> list[str]:
    if result is None:
        expected = "expected a minute of fixes with scan matches"
        return [f"Lever arm and horizontal base offset: not estimated, {expected}."]
    x_m, y_m = arm.x_m + result.lever_m[0], arm.y_m + result.lever_m[1]
    lever = (
        f"antenna {x_m:.3f} ± {result.lever_sigma_m[0]:.3f} m forward, "
        f"{y_m:.3f} ± {result.lever_sigma_m[1]:.3f} m left (set: {arm.x_m:g}, {arm.y_m:g})"
    )
    base = (
        f"{result.base_m[0]:+.3f} ± {result.base_sigma_m[0]:.3f} m east, "
        f"{result.base_m[1]:+.3f} ± {result.base_sigma_m[1]:.3f} m north"
    )
    used = f"{1.0 - result.used:.1%} of the pairs were rejected as outliers."
    if result.separable:
        return [f"Lever arm: {lever}. Base offset: {base}. {used}"]
    return [
        "Too few turns to separate lever arm and base offset. Either:",
        f"  lever arm, if the base is correct: {lever};",
        f"  base offset, if the lever arm is as set: {base}. {used}",
    ]


def _height_lines(height: CommonOffset | None, arm: LeverArm) -> list[str]:
    if height is None:
        return ["Antenna height: not estimated, expected fixes over 100 m of known road."]
    lines = [
        f"Antenna height above the road, mean of the drive: {height.value_m:.3f} ± {height.sigma_m:.3f} m "
        f"(set: {arm.z_m:g}), if the base's height is correct: the two are not separable on board."
    ]
    if height.drift_sigmas > 5.0:
        lines.append(f"It changed by {height.drift_m:.2f} m over the drive: no constant height describes it.")
    return lines


def _snippet(
    name: str, horizontal: HorizontalCalibration | None, height: CommonOffset | None, arm: LeverArm
) -> str:
    """Return tables for drive.toml; the base offset, which has no setting, as a comment."""
    lines = [f"# Estimated by {_PROG} from the drive {name}."]
    x_m, y_m, note = arm.x_m, arm.y_m, "  # as it was set"
    if horizontal is not None:
        x_m, y_m = x_m + float(horizontal.lever_m[0]), y_m + float(horizontal.lever_m[1])
        note = "" if horizontal.separable else "  # if the base is correct"
        if horizontal.separable:
            east_m, north_m = horizontal.base_m
            lines.append(f"# The base's coordinates put fixes {east_m:+.3f} m east, {north_m:+.3f} m north.")
    lines += ["[lever_arms.antenna]", f"x_m = {x_m:.3f}{note}", f"y_m = {y_m:.3f}{note}"]
    if height is None:
        return "\n".join([*lines, f"z_m = {arm.z_m:.3f}  # as it was set", ""])
    sigma_m = math.hypot(height.sigma_m, _LOAD_SIGMA_M)
    z_m = f"{height.value_m:.3f}"
    lines += [f"z_m = {z_m}", "", "[antenna_height]", 'way = "fixed"', f"height_m = {z_m}"]
    return "\n".join([*lines, f"sigma_m = {sigma_m:.3f}", ""])


def _parser() -> argparse.ArgumentParser:
    parser = tool_parser(_PROG, __doc__, allow_abbrev=False)
    add_drive(parser, "manifest with fixes, motion, a map, and optionally sweeps")
    add = parser.add_argument
    add("--out", type=Path, metavar="FILE", help="file for the TOML (default: standard output)")
    add("--quiet", action="store_true", help="no progress bar")
    return parser
