"""`camber calibrate`: lever arm, antenna height and base offset of a new vehicle, from its first recorded drive."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from camber.formats.errors import FormatError
from camber.integrity.learning.common_offset import CommonOffset
from camber.localizer.settings import LocalizerSettings
from camber.replay.drive_inputs import DriveInputs, prepare_drive
from camber.replay.lock_step.processes import config_text
from camber.runtime.settings import ConfigError, load
from camber.schemas.drive import DriveManifest, ManifestError, load_manifest
from camber.schemas.motion import LeverArm
from camber.schemas.toml_file import FileError
from camber.tools.calibrate.calibration import Horizontal, horizontal_of
from camber.tools.calibrate.calibration_run import Paired, height_of, pair
from camber.tools.localize.drive_anchors import receiver_fixes
from camber.tools.localize.local_map_queries import MapAtHand, release_for
from camber.tools.localize.localizer_config import localizer_config
from camber.tools.localize.localizer_run import localize

_PROG = "camber calibrate"
_LOAD_SIGMA_M = 0.01
"""By so much load and tyres move an antenna from drive to drive: a height measured on one is not surer than that."""


def main(argv: Sequence[str]) -> int:
    """Calibrate by one drive; 0 done, 2 it cannot be used, 130 interrupted."""
    args = _parser().parse_args(argv)
    try:
        said, snippet = calibrate(load_manifest(args.drive, args.set), quiet=args.quiet)
        if args.out is not None:
            args.out.parent.mkdir(parents=True, exist_ok=True)
            args.out.write_text(snippet, "utf-8")
    except (FileError, FormatError, ConfigError) as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{_PROG}: {error.filename or args.out}: {error.strerror or error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{_PROG}: interrupted", file=sys.stderr)
        return 130
    print(said if args.out is None else f"{said}\nWritten: {args.out}.")
    if args.out is None:
        print(f"\n{snippet}", end="")
    return 0


def calibrate(manifest: DriveManifest, *, quiet: bool = True) -> tuple[str, str]:
    """What a drive says of its vehicle, in words and as TOML for its manifest.

    Raises ManifestError where the drive lacks what it takes or says nothing, ConfigError, FormatError, OSError.
    """
    with TemporaryDirectory(prefix="camber-calibrate-") as folder:
        work = Path(folder)
        paired = _paired(prepare_drive(manifest, work / "work"), work, quiet=quiet)
    horizontal, height = horizontal_of(paired.pairs), height_of(paired.cells)
    if horizontal is None and height is None:
        raise ManifestError(
            f"{manifest.name}: {paired.fixes} fixes, {len(paired.pairs.time_ns)} of them beside a scan match and "
            f"{len(paired.cells)} stretches of known road, expected some minutes of one or the other"
        )
    arm = manifest.lever_arms.antenna
    said = "\n".join(_lines(manifest.name, paired, horizontal, height, arm))
    return said, _snippet(manifest.name, horizontal, height, arm)


def _paired(inputs: DriveInputs, work: Path, *, quiet: bool) -> Paired:
    """Fixes beside the poses of a localizer that hears none of them."""
    manifest = inputs.manifest
    fixes = receiver_fixes(inputs)
    missing = {
        "table motion, expected one, or wheel_speed and yaw_rate in surrogates.inputs": not inputs.motion,
        "initial_pose, expected one: no fix may have a part in the poses": inputs.initial_pose is None,
        "table map, expected one, or links and road_surfaces as surrogates": inputs.map_release is None,
    }
    for expected, is_missing in missing.items():
        if is_missing:
            raise ManifestError(f"{manifest.name}: no {expected}")
    assert inputs.map_release is not None
    file = work / "localizer.toml"
    file.write_text(config_text(localizer_config(manifest, inputs.initial_pose)) + "\n", "utf-8")
    settings, _ = load(LocalizerSettings, ["--config", str(file)], prog=_PROG)
    release = release_for(inputs.map_release, manifest.datum)
    drive = localize(inputs, settings.options(settings.initial_pose), MapAtHand(release), quiet=quiet)
    return pair(fixes, drive.poses)


def _lines(
    name: str, paired: Paired, horizontal: Horizontal | None, height: CommonOffset | None, arm: LeverArm
) -> list[str]:
    lines = [
        f"{name}: {paired.fixes:,} fixes, {len(paired.pairs.time_ns):,} beside a scan match, "
        f"{len(paired.cells):,} stretches of known road."
    ]
    if horizontal is None:
        lines.append(
            "Lever arm and horizontal base offset: not to be told without a minute of fixes beside scan matches."
        )
    else:
        lines += _horizontal_lines(horizontal, arm)
    if height is None:
        lines.append("Antenna height: not to be told without fixes over 100 m of known road.")
    else:
        lines += _height_lines(height, arm)
    return lines


def _horizontal_lines(found: Horizontal, arm: LeverArm) -> list[str]:
    x_m, y_m = arm.x_m + found.lever_m[0], arm.y_m + found.lever_m[1]
    lever = (
        f"antenna {x_m:.3f} ± {found.lever_sigma_m[0]:.3f} m forward, {y_m:.3f} ± {found.lever_sigma_m[1]:.3f} m left "
        f"(set: {arm.x_m:g}, {arm.y_m:g})"
    )
    base = (
        f"{found.base_m[0]:+.3f} ± {found.base_sigma_m[0]:.3f} m east, "
        f"{found.base_m[1]:+.3f} ± {found.base_sigma_m[1]:.3f} m north"
    )
    used = f"{1.0 - found.used:.1%} of the pairs are off it by more than errors are."
    if found.separable:
        return [f"Lever arm: {lever}. Base offset: {base}. {used}"]
    return [
        "Hardly a turn: lever arm and base cannot be told apart. One of two:",
        f"  lever arm, if the base is right: {lever};",
        f"  base offset, if the lever arm is as set: {base}. {used}",
    ]


def _height_lines(found: CommonOffset, arm: LeverArm) -> list[str]:
    lines = [
        f"Antenna height above the road, mean of the drive: {found.value_m:.3f} ± {found.sigma_m:.3f} m "
        f"(set: {arm.z_m:g}), if the base's height is right: nothing on board tells the two apart."
    ]
    if found.drift_sigmas > 5.0:
        lines.append(f"It changed by {found.drift_m:.2f} m over the drive: no constant height describes it.")
    return lines


def _snippet(name: str, horizontal: Horizontal | None, height: CommonOffset | None, arm: LeverArm) -> str:
    """Tables for drive.toml; what cannot be set there is a comment."""
    lines = [f"# Found by camber calibrate from the drive {name}."]
    if horizontal is not None and horizontal.separable:
        east_m, north_m = horizontal.base_m
        lines.append(f"# The base's coordinates put fixes {east_m:+.3f} m east, {north_m:+.3f} m north.")
    lines.append("[lever_arms.antenna]")
    off_m = (0.0, 0.0) if horizontal is None else (float(horizontal.lever_m[0]), float(horizontal.lever_m[1]))
    known = "" if horizontal is not None else "  # as it was set"
    sure = "" if horizontal is None or horizontal.separable else "  # if the base is right"
    lines += [f"x_m = {arm.x_m + off_m[0]:.3f}{known}{sure}", f"y_m = {arm.y_m + off_m[1]:.3f}{known}{sure}"]
    if height is None:
        return "\n".join([*lines, f"z_m = {arm.z_m:.3f}  # as it was set", ""])
    sigma_m = math.hypot(height.sigma_m, _LOAD_SIGMA_M)
    lines += [
        f"z_m = {height.value_m:.3f}",
        "",
        "[antenna_height]",
        'way = "fixed"',
        f"height_m = {height.value_m:.3f}",
        f"sigma_m = {sigma_m:.3f}",
    ]
    return "\n".join([*lines, ""])


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=_PROG, description=__doc__, allow_abbrev=False)
    parser.add_argument(
        "drive",
        type=Path,
        metavar="drive.toml",
        help="manifest with fixes, motion, a map, and sweeps if there are",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="where the TOML goes; without it, to the screen"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override the manifest"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    return parser
