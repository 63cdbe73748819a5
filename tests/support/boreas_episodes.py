"""Wrong-fix episodes injected into the two drives of `boreas-tracks`, judged on the map of the other day.

Places, heights and motion are the recording's, with errors of a car's sensors and of a receiver in streets added; the
map is the other day's track, its heights without any added error, so that the map's real error is the difference of the
two days. No LiDAR. Vectors of wrong fixes are those of the simulator's ambiguity search, their episodes last 1 to 20 s.

`PYTHONPATH=tests python -m support.boreas_episodes --drives 6 --processes 2` prints the figures of
docs/theory/map-errors.md.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camber.formats.drive.truth_csv import TruthTable, write_truth
from camber.formats.receiver.rtklib_pos import format_pos_header, format_pos_line
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.replay.drive_inputs import prepare_drive
from camber.replay.single_process_replay import replay_in_one_process
from camber.replay.surrogate_map import make_map
from camber.road_map.release import write_release
from camber.schemas.drive import Surrogates, load_manifest
from camber.schemas.integrity import CONFIRMED_VERDICTS
from camber.simulator.random_processes import gauss_markov, memory_of
from camber.simulator.random_streams import stream
from camber.validation.baselines import height_differences_m
from camber.validation.common_faults.fix_series import STREET
from camber.validation.common_faults.wrong_episodes import WrongEpisodes, wrong_episodes
from camber.validation.protection_level_statistics import positions_by_epoch
from camber.validation.reference_trajectory import truth_of
from support.boreas_localization import BOTH_DAYS, FRAME, ORIGIN_M, START_NS
from support.boreas_relief import MAP_SIGMA_M, folder

Floats = NDArray[np.float64]
_ANTENNA_M = 1.8  # any: it is taken off the heights of one day and added on the other
_FIXES_EVERY = 2  # rows of 10 Hz
_FIRST_S, _LENGTH_S = 60.0, (1.0, 20.0)
_WRONG_M, _RIGHT_M, _HEIGHT_GATE_M = 0.5, 0.2, 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Counts:
    """Of one drive, or of several together."""

    drives: int
    episodes: int
    longer_than_one_epoch: int
    """Episodes of which fixes more than 0.5 m off were confirmed at two epochs in a row or more."""
    wrong: int
    wrong_confirmed: int
    right: int
    right_kept: int
    right_erroneous: int
    wrong_by_height_alone: int
    right_by_height_alone: int
    usable: int
    beyond_level: int
    epochs: int

    def __add__(self, other: Counts) -> Counts:
        return Counts(**{name: getattr(self, name) + getattr(other, name) for name in self.__slots__})


@cache
def truth(day: str) -> TruthTable:
    """One day's drive: 10 Hz, heights as they are, level."""
    path = folder()
    assert path is not None
    rows = np.genfromtxt(path / f"{day}.csv", delimiter=",", skip_header=1)
    place = rows[:, 1:3] - ORIGIN_M
    latitude, longitude, _ = FRAME.geodetic_from_east_north_array(place, rows[:, 3])
    speed = np.hypot(rows[:, 4], rows[:, 5])
    last = np.maximum.accumulate(np.where(speed > 0.5, np.arange(len(rows)), int(np.argmax(speed > 0.5))))
    yaw = np.arctan2(rows[last, 5], rows[last, 4])
    return TruthTable(
        time_ns=START_NS + np.round((rows[:, 0] - rows[0, 0]) * 1e3).astype(np.int64),
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=rows[:, 3],
        roll_rad=np.zeros(len(rows)),
        pitch_rad=np.zeros(len(rows)),
        yaw_rad=yaw,
        velocity_enu_m_s=rows[:, 4:7],
    )


def write_other_days_map(path: Path, day: str, seed: int) -> None:
    """A release of the roads that were driven on `day`: heights without added error, at the σ of the two days."""
    errors = Surrogates(
        allow_smaller_errors=True, seed=seed, map_sigma_m=1e-6, map_common_offset_sigma_m=1e-6
    )
    surfaces, links = make_map(truth(day), errors, _ANTENNA_M)
    stated = replace(surfaces, sigma_m=np.full(len(surfaces.sigma_m), MAP_SIGMA_M))
    write_release(
        path,
        region="toronto",
        map_version=1,
        datum="WGS84",
        epoch_year=2021.6,
        time_ns=START_NS,
        surfaces=stated,
        links=links,
        surrogate=f"track of {day}",
    )


def _errors(seed: int, count: int, step_s: float, episodes: WrongEpisodes) -> Floats:
    memory = np.full(count, float(memory_of(np.array(step_s), STREET.correlation_s)))
    slow = gauss_markov(stream(seed, "fix slow").standard_normal((count, 3)), memory)
    white = stream(seed, "fix white").standard_normal((count, 3))
    noise: Floats = slow * STREET.slow_m + white * STREET.white_m
    return noise + episodes.offset_m(np.arange(count) * step_s)


def _solutions(
    drive: TruthTable, error_m: Floats, episodes: WrongEpisodes, seed: int
) -> list[ReceiverSolution]:
    place = FRAME.east_north_from_geodetic_array(drive.latitude_rad, drive.longitude_rad, drive.height_m)
    latitude, longitude, _ = FRAME.geodetic_from_east_north_array(place + error_m[:, :2], drive.height_m)
    time_s = (drive.time_ns - drive.time_ns[0]) * 1e-9
    few = episodes.satellites(time_s)
    many = np.where(few > 0, few, stream(seed, "satellites").integers(10, 18, len(drive)))
    ee, nn, uu = (sigma_m**2 for sigma_m in STREET.claimed_m)
    return [
        ReceiverSolution(
            time_ns=int(drive.time_ns[k]),
            latitude_rad=float(latitude[k]),
            longitude_rad=float(longitude[k]),
            height_m=float(drive.height_m[k] + error_m[k, 2]),
            quality=SolutionQuality.FIX,
            satellites=int(many[k]),
            covariance_enu_m2=(ee, 0.0, 0.0, nn, 0.0, uu),
            age_s=1.0,
            ratio=5.0,
        )
        for k in range(len(drive))
    ]


def judged(map_day: str, drive_day: str, reference: str, seed: int) -> Counts:
    """One drive with its episodes, through all services."""
    drive = truth(drive_day)
    fixes = drive.rows(slice(None, None, _FIXES_EVERY))
    time_s = (fixes.time_ns - fixes.time_ns[0]) * 1e-9
    episodes = wrong_episodes(seed, first_s=_FIRST_S, lasts_s=float(time_s[-1]), length_s=_LENGTH_S)
    error_m = _errors(seed, len(fixes), float(np.median(np.diff(time_s))), episodes)
    lines = (format_pos_line(one) for one in _solutions(fixes, error_m, episodes, seed))
    with tempfile.TemporaryDirectory() as name:
        path = Path(name)
        (path / "receiver.pos").write_bytes(b"".join((format_pos_header(), *lines)))
        write_truth(path / "truth.csv", drive)
        write_other_days_map(path / "map", map_day, seed)
        (path / "drive.toml").write_text(_manifest(seed, reference), "utf-8")
        inputs = prepare_drive(load_manifest(path / "drive.toml"), path / "work")
        output = replay_in_one_process(
            inputs, path, channels=("fix", "verdict", "position", "pose", "antenna_height")
        )
    wrong = np.linalg.norm(error_m, axis=1) > _WRONG_M
    right = np.linalg.norm(error_m, axis=1) <= _RIGHT_M
    verdicts = {
        v.message.time_ns: v.message.verdict
        for v in output.recorded["verdict"]
        if v.message.fix_id is not None
    }
    names = np.array([verdicts.get(t, "none") for t in fixes.time_ns.tolist()])
    confirmed = np.isin(names, CONFIRMED_VERDICTS)
    by_fix = {item.message.time_ns: item.message for item in output.recorded["fix"]}
    ordered = [by_fix[t] for t in fixes.time_ns.tolist() if t in by_fix]
    known = np.array([t in by_fix for t in fixes.time_ns.tolist()])
    difference = np.full(len(fixes), np.nan)
    difference[known] = height_differences_m(
        ordered, output.recorded["pose"], output.recorded["antenna_height"]
    )
    by_height = np.abs(difference) <= _HEIGHT_GATE_M
    positions = positions_by_epoch(output.recorded["position"], truth_of(drive), (0.0, 0.0, 0.0), None)
    last = {item.message.time_ns: item.message for item in output.recorded["position"]}
    usable = np.array([last[t].usable for t in positions.time_ns.tolist()], bool)
    pairs = wrong & confirmed
    pairs[1:] &= pairs[:-1].copy()
    pairs[0] = False
    row = np.searchsorted(episodes.begin_s, time_s, side="right") - 1
    return Counts(
        drives=1,
        episodes=len(np.unique(row[wrong & (row >= 0)])),
        longer_than_one_epoch=len(np.unique(row[pairs])),
        wrong=int(wrong.sum()),
        wrong_confirmed=int((wrong & confirmed).sum()),
        right=int(right.sum()),
        right_kept=int((right & confirmed).sum()),
        right_erroneous=int((right & (names == "erroneous")).sum()),
        wrong_by_height_alone=int((wrong & by_height).sum()),
        right_by_height_alone=int((right & by_height).sum()),
        usable=int(usable.sum()),
        beyond_level=int((usable & (positions.horizontal_error_m > positions.hpl_m)).sum()),
        epochs=len(usable),
    )


def _manifest(seed: int, reference: str) -> str:
    return (
        'name = "boreas"\ndescription = "boreas-tracks with wrong fixes"\nvehicle = "car"\ndatum = "WGS84"\n'
        f'horizontal_reference = "{reference}"\n'
        '[receiver]\nformat = "pos"\nfile = "receiver.pos"\n[map]\nrelease = "map"\n'
        '[truth]\nformat = "camber"\nfile = "truth.csv"\n'
        f'[antenna_height]\nway = "fixed"\nheight_m = {_ANTENNA_M}\nsigma_m = 0.01\n'
        f"[lever_arms.antenna]\nz_m = {_ANTENNA_M}\n"
        f'[surrogates]\nseed = {seed}\ninputs = ["wheel_speed", "yaw_rate", "steering", "initial_pose"]\n'
    )


def _job(job: tuple[str, str, str, int]) -> Counts:
    return judged(*job)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=4, help="of each direction")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--reference", default="assumed", choices=("assumed", "required"))
    args = parser.parse_args(argv)
    seeds = range(args.first_seed, args.first_seed + args.drives)
    jobs = [(*days, args.reference, seed) for seed in seeds for days in BOTH_DAYS]
    total: dict[str, Counts] = {}
    with ProcessPoolExecutor(args.processes, mp_context=get_context("spawn")) as pool:
        for job, counts in zip(jobs, pool.map(_job, jobs), strict=True):
            total[job[1]] = total[job[1]] + counts if job[1] in total else counts
            print(job[1], job[3], counts, flush=True)
    for day, c in total.items():
        print(
            f"drive of {day}: {c.drives} drives, {c.episodes} episodes, of which {c.longer_than_one_epoch} confirmed "
            f"for longer than one epoch; wrong confirmed {c.wrong_confirmed} of {c.wrong}, by height alone "
            f"{c.wrong_by_height_alone}; right kept {c.right_kept / c.right:.4f} of {c.right}, "
            f"by height alone {c.right_by_height_alone / c.right:.4f}, erroneous {c.right_erroneous}; "
            f"usable {c.usable / c.epochs:.3f}, "
            f"beyond their level {c.beyond_level}"
        )


if __name__ == "__main__":
    main()
