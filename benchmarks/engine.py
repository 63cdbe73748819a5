"""The RTK engine beside RTKLIB's `rnx2rtkp`, from the same RINEX files to positions, one epoch by itself.

CPU seconds of one thread on both sides, parsing included; of the peer the start-up is taken off, a run over the first
epoch of the same files. Ours runs with compiled code warm. The recordings of $CAMBER_DATA are repeated until there are
3,600 epochs; without the variable, or without rnx2rtkp, there is no figure.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from figure import Figure, higher, lower

from camber.geodesy.ellipsoid import ecef_from_geodetic_scalar
from camber.gnss.candidates.satellite_subsets import subset_candidates
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.rtk_engine import Engine, Solution
from support.gnss_files import read_navigation, read_observations

EPOCHS = 3600
OF_ALL = "atmosphere_m2"  # the one of the rows that is no column
GOAL_TRIALS_MS = 10.0
GOAL_MEMORY_MB = 300.0
OPTIONS = """pos1-posmode=kinematic
pos1-frequency=l1+2
pos1-elmask=10
pos1-ionoopt=brdc
pos1-tropopt=saas
pos1-navsys=57
pos2-armode=instantaneous
pos2-gloarmode=off
pos2-arthres=3
ant2-postype=xyz
"""


@dataclass(frozen=True)
class Recording:
    """Files of one recording below $CAMBER_DATA, and where its base stands (ECEF, m)."""

    name: str
    rover: Path
    base: Path
    navigation: Path
    base_ecef_m: tuple[float, float, float]


def recordings(data: Path) -> list[Recording]:
    fujisawa, rooftop = data / "fujisawa-2021-09-22", data / "rooftop-2024-06-24"
    text = (rooftop / "base_position.txt").read_text()
    latitude, longitude, height = (float(part) for part in text.replace(",", " ").split())
    on_roof = ecef_from_geodetic_scalar(float(np.deg2rad(latitude)), float(np.deg2rad(longitude)), height)
    return [
        Recording("fujisawa", fujisawa / "SEPT265G.21O", fujisawa / "3034265G.21O", fujisawa / "SEPT2650.21P",
                  (-3959400.631, 3385704.533, 3667523.111)),
        Recording("rooftop", rooftop / "rover.obs", rooftop / "base.obs", rooftop / "base.nav", on_roof),
    ]  # fmt: skip


def solve(recording: Recording) -> list[Solution]:
    """From the files to all positions."""
    rover, base = read_observations(recording.rover), read_observations(recording.base)
    engine = Engine(EngineSettings(), np.array(recording.base_ecef_m))
    for ephemeris in read_navigation(recording.navigation).ephemerides:
        engine.add_ephemeris(ephemeris)
    solutions, waiting = [], iter(base.epochs)
    of_base = next(waiting, None)
    for epoch in rover.epochs:
        while of_base is not None and of_base.time_ns <= epoch.time_ns + 5_000_000:
            engine.add_base(of_base)
            of_base = next(waiting, None)
        solutions.append(engine.solve(epoch))
    return solutions


def rtklib_cpu_s(recording: Recording, folder: Path, *, epochs: int | None = None) -> tuple[float, int, int]:
    """CPU seconds of one run over the first `epochs` of the files, epochs and fixes that it wrote."""
    x, y, z = recording.base_ecef_m
    where = f"ant2-pos1={x:.4f}\nant2-pos2={y:.4f}\nant2-pos3={z:.4f}\n"
    (folder / "options.conf").write_text(OPTIONS + where)
    files = [recording.rover, recording.base]
    if epochs is not None:
        files = [_first(file, folder / f"first-{k}.obs", epochs) for k, file in enumerate(files)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        ["rnx2rtkp", "-k", "options.conf", "-o", "out.pos", *map(str, files), str(recording.navigation)],
        cwd=folder, check=True, capture_output=True, stdin=subprocess.DEVNULL, timeout=120.0,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    rows = [
        line.split() for line in (folder / "out.pos").read_text().splitlines() if not line.startswith("%")
    ]
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu_s, len(rows), sum(row[5] == "1" for row in rows)


def _first(file: Path, to: Path, epochs: int) -> Path:
    """The header and the first epochs of an observation file."""
    header, *parts = file.read_text().split("\n>")
    to.write_text("\n>".join([header, *parts[:epochs]]) + "\n")
    return to


def rates(recording: Recording, folder: Path) -> list[Figure]:
    solutions = solve(recording)  # warm
    count = len(solutions)
    rounds = -(-EPOCHS // count)
    ours_s, theirs_s = [], []
    started_s = min(rtklib_cpu_s(recording, folder, epochs=1)[0] for _ in range(3))
    for _ in range(rounds):
        began = time.process_time()
        solve(recording)
        ours_s.append(time.process_time() - began)
        theirs_s.append(rtklib_cpu_s(recording, folder)[0] - started_s)
    _, _, their_fixes = rtklib_cpu_s(recording, folder)
    fixes = sum(solution.quality == "fixed" for solution in solutions)
    ours, theirs = count * rounds / sum(ours_s), count * rounds / sum(theirs_s)
    return [
        higher(
            f"engine, {recording.name}", "epochs/s of one core", ours, theirs, "rnx2rtkp, start-up taken off"
        ),
        higher(
            f"fixes of {recording.name}, {count} epochs", "epochs", fixes, their_fixes, "rnx2rtkp, ratio 3"
        ),
    ]


def trials(recording: Recording) -> Figure:
    """Twenty other estimates of an epoch of 25 satellites in two bands."""
    rover, base = read_observations(recording.rover), read_observations(recording.base)
    options = EngineSettings(gps_bands="12", galileo_bands="17", beidou_bands="27")
    engine = Engine(options, np.array(recording.base_ecef_m))
    for ephemeris in read_navigation(recording.navigation).ephemerides:
        engine.add_ephemeris(ephemeris)
    took_ms, of_base = [], {epoch.time_ns: epoch for epoch in base.epochs}
    for epoch in rover.epochs:
        engine.add_base(of_base[epoch.time_ns])
        solution = engine.solve(epoch)
        if solution.rows is None or solution.approximate_ecef_m is None:
            continue
        satellites, bands = np.unique(solution.rows.satellite, return_counts=True)
        chosen = np.isin(solution.rows.satellite, satellites[bands == 2][:25])
        columns = {name: column[chosen] for name, column in solution.rows._asdict().items() if name != OF_ALL}
        reduced = replace(solution, rows=solution.rows._replace(**columns))
        began = time.perf_counter()
        count, _ = subset_candidates(reduced, options.fix_criteria(), "all", most_trials=20)
        took_ms.append(1e3 * (time.perf_counter() - began))
        assert count == 20
    p99 = float(np.quantile(took_ms[5:], 0.99))
    return lower("20 other estimates of 25 satellites, two bands, p99", "ms", p99, GOAL_TRIALS_MS, "the goal")


def memory(recording: Recording) -> Figure:
    """Peak of a process that only does this."""
    code = (
        "import resource, engine, os, pathlib\n"
        "r = engine.recordings(pathlib.Path(os.environ['CAMBER_DATA']))[-1]\n"
        "engine.solve(r)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=Path(__file__).parent, check=True, capture_output=True, text=True
    )
    return lower("peak memory of the engine", "MB", int(run.stdout) / 1024.0, GOAL_MEMORY_MB, "the goal")


def figures() -> list[Figure]:
    data = os.environ.get("CAMBER_DATA")
    if not data or shutil.which("rnx2rtkp") is None:
        print("engine: no figure without CAMBER_DATA and rnx2rtkp (Debian: rtklib)", file=sys.stderr)
        return []
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory() as folder:
        for recording in recordings(Path(data)):
            figures += rates(recording, Path(folder))
        figures += [trials(recording), memory(recording)]
    return figures
