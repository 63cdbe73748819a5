"""`camber gnss solve`: RTK positions from raw observations, as an RTKLIB solution file and a plot.

What to solve is a drive's manifest with a table observations, or files: those of rover and base and at least one with
broadcast ephemerides, in this order.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camber.formats.drive.truth_csv import WRONG_M, read_truth
from camber.formats.observations import Floats, ObservationEpoch
from camber.formats.receiver.rtklib_pos import format_pos_header, format_pos_line
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.ellipsoid import geodetic_from_ecef, geodetic_from_ecef_scalar
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.geodesy.local_frame import LocalFrame
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.rtk_engine import Engine
from camber.gnss.warm_up import CARRIED_FUNCTIONS, ENGINE_FUNCTIONS, engine_compiled_in_parallel, warm_up
from camber.schemas.drive import DriveManifest, ManifestError, load_manifest
from camber.tools.gnss.raw_recording import RawRecording, load_raw
from camber.tools.gnss.recording_summary import time_text
from camber.tools.gnss.solve_plot import SolvedDrive, solution_figure
from camber.tools.options.compilation_bar import compilation_bar
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import number_from
from camber.tools.options.output_check import check_output_folder
from camber.tools.options.parsers import add_with_default, tool_parser
from camber.tools.options.progress_display import ProgressDisplay
from camber.validation.plots import require_matplotlib, svg_text
from camber.validation.reference_trajectory import offset_of, truth_of

_PROG = "camber gnss solve"
_QUALITIES = {"fixed": SolutionQuality.FIX, "float": SolutionQuality.FLOAT, "single": SolutionQuality.SINGLE}
_HIGHEST_M = 20_000.0
"""Chosen: no base station is so high."""
RINEX_FUNCTIONS = 1
"""Compiled functions that reading observations in RINEX calls from Python; UBX and RTCM need up to four."""
_SAME_TIME_NS = NS_PER_SECOND // 50
"""Chosen: receiver clocks differ by less; epochs of rover and base within this are of one time."""


def main(argv: Sequence[str]) -> int:
    """Solve one drive; 0 success, 2 the drive cannot be used, 130 interrupted."""
    parser = _parser()
    args = parser.parse_args(argv)
    options = _options(args)
    if len(args.inputs) == 2 or (len(args.inputs) > 2 and args.set):
        parser.error("expected a manifest, which --set overrides, or files of rover, base and ephemerides")

    def work() -> str:
        check_output_folder(args.out, "engine.pos")
        if len(args.inputs) == 1:
            return solve(load_manifest(args.inputs[0], args.set), options, args.out)
        return solve_files(args.inputs, options, args.out, base_ecef_m=args.base_ecef_m)

    return report_failures(_PROG, args.out, work)


def solve(manifest: DriveManifest, options: EngineSettings, out: Path) -> str:
    """Write `engine.pos` and `engine.svg` of a drive into a folder; returns a summary.

    Raises ManifestError where the drive has no raw observations or none in its time, FormatError, OSError.
    """
    require_matplotlib()
    raw = manifest.observations
    if raw is None:
        raise ManifestError(f"{manifest.name}: no table observations, expected raw observations and a base")
    recording = _load(
        raw.rover_obs, raw.base_obs, raw.ephemerides, base_ecef_m=raw.base_ecef_m, options=options
    )
    rover = _within(recording.rover, manifest)
    if not rover:
        raise ManifestError(f"{manifest.name}: no epoch of the rover from start_s to end_s, expected some")
    solved = _run_with_display(recording, rover, options)
    errors_m = _errors_m(manifest, solved)
    return _written(manifest.name, recording, solved, options, errors_m=errors_m, out=out)


def solve_files(
    files: Sequence[Path],
    options: EngineSettings,
    out: Path,
    *,
    base_ecef_m: tuple[float, float, float] | None = None,
) -> str:
    """The same of files: rover, base, then ephemerides. Raises FormatError, OSError."""
    require_matplotlib()
    rover, base, *ephemerides = files
    recording = _load(rover, base, ephemerides, base_ecef_m=base_ecef_m, options=options)
    solved = _run_with_display(recording, recording.rover, options)
    return _written(rover.name, recording, solved, options, errors_m=None, out=out)


def _load(
    rover: Path,
    base: Path,
    ephemerides: Sequence[Path],
    *,
    base_ecef_m: tuple[float, float, float] | None,
    options: EngineSettings,
) -> RawRecording:
    """Read the files and compile the engine, as far as that was not done before."""
    carried = options.ambiguities == "carried"
    functions = RINEX_FUNCTIONS + ENGINE_FUNCTIONS + (CARRIED_FUNCTIONS if carried else 0)
    with compilation_bar(functions), engine_compiled_in_parallel():
        recording = load_raw(rover, base, ephemerides, base_ecef_m=base_ecef_m)
        warm_up(subsets=False, carried=carried)
    return recording


def _written(
    name: str,
    recording: RawRecording,
    solved: SolvedDrive,
    options: EngineSettings,
    *,
    errors_m: Floats | None,
    out: Path,
) -> str:
    places = geodetic_places(solved)
    out.mkdir(parents=True, exist_ok=True)
    (out / "engine.pos").write_bytes(_pos_file(solved, places))
    figure = solution_figure(name, solved, places, options.least_ratio)
    (out / "engine.svg").write_text(svg_text(figure), "utf-8")
    summary = _summary(name, recording, solved, errors_m=errors_m, out=out)
    return "\n".join([summary, *recording.notes])


def _run_with_display(
    recording: RawRecording, rover: Sequence[ObservationEpoch], options: EngineSettings
) -> SolvedDrive:
    with ProgressDisplay(len(rover), "epoch") as display:
        return run_engine(recording, rover, options, progress=display.advance)


def run_engine(
    recording: RawRecording,
    rover: Sequence[ObservationEpoch],
    options: EngineSettings,
    *,
    progress: Callable[[], object] = lambda: None,
) -> SolvedDrive:
    """Solve the rover's epochs in order, each with the newest base epoch at its time; all ephemerides known at once, as
    in post-processing. `progress` is called after each epoch."""
    sets = Counter(ephemeris.satellite for ephemeris in recording.ephemerides)
    most = max(options.ephemerides_of_satellite, *sets.values(), 0)
    engine = Engine(options.model_copy(update={"ephemerides_of_satellite": most}), recording.base_ecef_m)
    for ephemeris in recording.ephemerides:
        engine.add_ephemeris(ephemeris)
    if recording.ionosphere is not None:
        engine.ionosphere = recording.ionosphere
    base = sorted(recording.base, key=lambda epoch: epoch.time_ns)
    n, place, began_s = len(rover), 0, 0.0
    quality, continuity = np.full(n, "none", "U6"), np.full(n, "no_evidence", "U11")
    position, covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    satellites, ratio, age_s = np.zeros(n, np.int64), np.full(n, np.nan), np.full(n, np.nan)
    for k, epoch in enumerate(rover):
        if k == 1:
            began_s = time.perf_counter()
        while place < len(base) and base[place].time_ns <= epoch.time_ns + _SAME_TIME_NS:
            engine.add_base(base[place])
            place += 1
        solution = engine.solve(epoch)
        quality[k], continuity[k], satellites[k] = solution.quality, solution.continuity, solution.satellites
        if solution.position_ecef_m is not None and solution.covariance_ecef_m2 is not None:
            position[k], covariance[k] = solution.position_ecef_m, solution.covariance_ecef_m2
        ratio[k] = math.nan if solution.ratio is None else solution.ratio
        age_s[k] = math.nan if solution.age_s is None else solution.age_s
        progress()
    return SolvedDrive(
        time_ns=np.array([epoch.time_ns for epoch in rover], np.int64),
        quality=quality,
        continuity=continuity,
        position_ecef_m=position,
        covariance_ecef_m2=covariance,
        satellites=satellites,
        ratio=ratio,
        age_s=age_s,
        reasons=engine.reasons,
        warnings=Counter(engine.warnings),
        epochs_per_s=None if n < 2 else (n - 1) / (time.perf_counter() - began_s),
    )


def _within(rover: list[ObservationEpoch], manifest: DriveManifest) -> list[ObservationEpoch]:
    """From `start_s` to `end_s` after the first epoch."""
    first_ns = rover[0].time_ns
    begin_s = manifest.start_s or 0.0
    end_s = math.inf if manifest.end_s is None else manifest.end_s
    return [epoch for epoch in rover if begin_s <= (epoch.time_ns - first_ns) / NS_PER_SECOND <= end_s]


def geodetic_places(solved: SolvedDrive) -> Floats:
    """Latitude, longitude [rad], ellipsoidal height [m] (n, 3); NaN where there is no position."""
    places = np.full((len(solved.time_ns), 3), np.nan)
    known = solved.quality != "none"
    if known.any():
        places[known] = np.column_stack(geodetic_from_ecef(solved.position_ecef_m[known]))
    return places


def _pos_file(solved: SolvedDrive, places: Floats) -> bytes:
    lines = [format_pos_header()]
    for k in np.flatnonzero(solved.quality != "none").tolist():
        latitude_rad, longitude_rad, height_m = places[k].tolist()
        turn = LocalFrame(latitude_rad, longitude_rad, height_m).enu_from_ecef_rotation()
        enu = turn @ solved.covariance_ecef_m2[k] @ turn.T
        ratio, age_s = float(solved.ratio[k]), float(solved.age_s[k])
        solution = ReceiverSolution(
            time_ns=int(solved.time_ns[k]),
            latitude_rad=latitude_rad,
            longitude_rad=longitude_rad,
            height_m=height_m,
            quality=_QUALITIES[str(solved.quality[k])],
            satellites=int(solved.satellites[k]),
            covariance_enu_m2=(enu[0, 0], enu[0, 1], enu[0, 2], enu[1, 1], enu[1, 2], enu[2, 2]),
            age_s=None if math.isnan(age_s) else age_s,
            ratio=None if math.isnan(ratio) else ratio,
        )
        lines.append(format_pos_line(solution))
    return b"".join(lines)


def _errors_m(manifest: DriveManifest, solved: SolvedDrive) -> Floats | None:
    """Return 3D errors (n,) against the truth, NaN where it is unknown; None without truth."""
    if manifest.truth is None:
        return None
    places = geodetic_places(solved)
    truth = truth_of(read_truth(manifest.truth.file, manifest.truth.format))
    error_enu_m = truth.error_enu_m(
        solved.time_ns, places[:, 0], places[:, 1], places[:, 2], offset_enu_m=offset_of(manifest)
    )
    distance_m: Floats = np.linalg.norm(error_enu_m, axis=1)
    return distance_m


def _summary(
    name: str,
    recording: RawRecording,
    solved: SolvedDrive,
    *,
    errors_m: Floats | None,
    out: Path,
) -> str:
    n = len(solved.time_ns)
    counts = Counter(solved.quality.tolist())
    shares = ", ".join(f"{counts[q]:,} {q} ({counts[q] / n:.1%})" for q in (*_QUALITIES, "none"))
    reasons = [(reason, count) for reason, count in solved.reasons.most_common() if reason != "resolved"]
    chain = Counter(solved.continuity[solved.quality == "fixed"].tolist())
    parts = [
        f"{name}: {n:,} epochs from {time_text(int(solved.time_ns[0]))} GPS time: {shares}.",
        f"Not fixed: {_counted(reasons)}." if reasons else "",
        f"Integers of the fixes: {_counted(chain.most_common())}." if chain else "",
        f"Issues: {_counted(solved.warnings.most_common())}." if solved.warnings else "",
        f"Base position from {recording.base_position_from}.",
        "" if errors_m is None else _accuracy(errors_m[solved.quality == "fixed"]),
        "" if solved.epochs_per_s is None else f"{solved.epochs_per_s:,.0f} epochs/s.",
        f"Written: {out / 'engine.pos'}, {out / 'engine.svg'}.",
    ]
    return " ".join(part for part in parts if part)


def _accuracy(errors_m: Floats) -> str:
    known = errors_m[~np.isnan(errors_m)]
    if not known.size:
        return "No fix has a truth beside it."
    p50, p95 = np.quantile(known, (0.5, 0.95))
    wrong = int((known > WRONG_M).sum())
    return (
        f"Errors in 3D of {known.size:,} fixes with truth: p50 {p50:.3f} m, p95 {p95:.3f} m, "
        f"largest {known.max():.3f} m, {wrong:,} wrong by more than {WRONG_M} m."
    )


def _counted(counts: Sequence[tuple[str, int]]) -> str:
    return ", ".join(f"{count:,} {name.replace('_', ' ')}" for name, count in counts)


def _options(args: argparse.Namespace) -> EngineSettings:
    names = {"G": "gps_bands", "E": "galileo_bands", "C": "beidou_bands", "R": "glonass_bands"}
    update: dict[str, Any] = {name: "" for letter, name in names.items() if letter not in args.systems}
    update |= {"lowest_elevation_deg": args.elevation_deg, "least_cn0_dbhz": args.cn0_dbhz}
    return EngineSettings().model_copy(update={**update, "least_ratio": args.ratio, "partial": args.partial})


def _systems(text: str) -> str:
    letters = text.upper()
    if (
        not set(letters) & set("GEC")
        or set(letters) - set("GJECR")
        or ("J" in letters and "G" not in letters)
    ):
        expected = "letters of G (with QZSS), E (Galileo), C (BeiDou), with them R (GLONASS)"
        raise argparse.ArgumentTypeError(f"{text!r}, expected {expected}")
    return letters


def _ecef(text: str) -> tuple[float, float, float]:
    """Raise ArgumentTypeError for what is no place near the earth's surface."""
    try:
        x, y, z = map(float, text.split(","))
        place = (x, y, z)
        geodetic = geodetic_from_ecef_scalar(*place)
    except ValueError:
        geodetic = None
    if geodetic is None or not abs(geodetic[2]) <= _HIGHEST_M:
        raise argparse.ArgumentTypeError(f"{text!r}, expected X,Y,Z in metres, a place on the earth")
    return place


def _parser() -> argparse.ArgumentParser:
    default = EngineSettings()
    parser = tool_parser(_PROG, __doc__)
    add = parser.add_argument
    add(
        "inputs",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="drive.toml, or files: rover base ephemerides ...",
    )
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="override the manifest")
    add(
        "--base-ecef-m",
        type=_ecef,
        metavar="X,Y,Z",
        help="where the base's antenna is, for files; ECEF, metres",
    )
    add_with_default(parser, "--out", Path("out/solve"), "output folder", type=Path, metavar="DIR")
    for name, bounds, value, text in (
        ("--ratio", (1.0, 1e3), default.least_ratio, "threshold of the ratio test"),
        ("--elevation-deg", (0.0, 89.0), default.lowest_elevation_deg, "elevation mask in degrees"),
        ("--cn0-dbhz", (0.0, 60.0), default.least_cn0_dbhz, "C/N0 mask in dB-Hz"),
    ):
        add_with_default(parser, name, value, text, type=number_from(*bounds))
    add_with_default(
        parser, "--systems", "GECR", "G (GPS with QZSS), E (Galileo), C (BeiDou), R (GLONASS)", type=_systems
    )
    text, both = "partial ambiguity resolution where not all can be fixed", argparse.BooleanOptionalAction
    parser.add_argument("--partial", action=both, default=default.partial, help=text)
    return parser
