"""Simulated drives through the localizer in this process, and what came out beside the truth.

`kept_drive` makes a drive once, all of its sweeps in memory (1 MB each) or in a file; `localized` runs the localizer
over it as it runs in a vehicle; `matched_alone` runs the scan matcher without the filter: each match begins half a
metre and two degrees from the truth, with a local map of its own.

Errors are along the true heading and to its left: of the antenna for poses, of the vehicle frame's origin for matches.
"""

from __future__ import annotations

import math
import os
import pickle
import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.angles import wrap_pi
from camber.geodesy.local_frame import LocalFrame
from camber.localizer.filter.pose_estimate import Prediction
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.scan_match_update import MatchUpdate
from camber.localizer.filter.track import OverlayLag
from camber.localizer.local_plane import LocalPlane
from camber.localizer.localization import Localization, LocalizationOptions
from camber.localizer.matching.scan_matcher import ScanMatcher
from camber.localizer.settings import LocalizerSettings
from camber.road_map.release import read_release
from camber.schemas.drive import InitialPose
from camber.schemas.pose import Pose, Road, ScanMatch
from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats, Integers
from camber.simulator.vehicle.body import CAR
from camber.tools.localize.local_map_queries import LocalMapQueries
from camber.tools.localize.localizer_run import IssueTally
from support.lidar_drives import DriveTruth, Tick, lidar_drive

ALONE_EVERY = 10
"""Sweeps from one match of `matched_alone` to the next: their local maps have none in common."""
START_OFF_M = 0.5
SEAM_M = 15.0
OTHER_ROAD_M = 1.0
START_OFF_RAD = math.radians(2.0)
_NO_LAG = OverlayLag()


@dataclass(frozen=True, slots=True, eq=False)
class KeptDrive:
    """What the sensors measured, the truth at 100 Hz, a given pose, and the map's folder."""

    name: str
    drive_seed: int
    ticks: list[Tick]
    truth: DriveTruth
    given: InitialPose
    map_folder: Path


def kept_drive(
    scenario: str, seed: int, *, folder: Path | None = None, every: int = 1, **options: Any
) -> KeptDrive:
    """A drive as `lidar_drive` makes it, of its sweeps each `every`-th; `folder`: kept there, and read from there the
    next time."""
    drawn = options if every == 1 else {**options, "every": every}
    name = "-".join([scenario, str(seed), *(f"{k}={v}" for k, v in sorted(drawn.items()))])
    if folder is not None and (folder / name / "drive.pickle").exists():
        with (folder / name / "drive.pickle").open("rb") as file:
            return replace(pickle.load(file), map_folder=folder / name / "map")
    drive = lidar_drive(scenario, seed, **options)
    times_ns = np.arange(drive.start_ns, drive.end_ns + 1, 10_000_000, dtype=np.int64)
    kept = KeptDrive(
        name,
        drive.drive_seed,
        list(drive.ticks(every=every)),
        drive.truth_at(times_ns),
        drive.given_pose(),
        drive.map_folder,
    )
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(dir=folder))
        shutil.copytree(drive.map_folder, part / "map")
        with (part / "drive.pickle").open("wb") as file:
            pickle.dump(kept, file, pickle.HIGHEST_PROTOCOL)
        os.replace(part, folder / name)
    return kept


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Rows (n,) of one drive in the order of their times: along and left [m], yaw [rad], covariances (n, 3, 3) of the
    three; `word` is the mode of a pose, status and reason of a match."""

    seconds: Floats
    off: Floats
    covariance: Floats
    word: tuple[str, ...]

    @property
    def horizontal_m(self) -> Floats:
        """Lengths (n,) of the horizontal errors."""
        return np.hypot(self.off[:, 0], self.off[:, 1])

    @property
    def squared(self) -> Floats:
        """Normalised squares (n,) of the horizontal errors: χ² of two degrees of freedom where σ are honest."""
        half = np.linalg.solve(self.covariance[:, :2, :2], self.off[:, :2, None])[:, :, 0]
        return np.einsum("ni,ni->n", self.off[:, :2], half)

    def since(self, seconds: float) -> Errors:
        """Those from so long after the drive's beginning on."""
        return self.where(self.seconds >= seconds)

    def where(self, chosen: NDArray[np.bool_]) -> Errors:
        """Some of them."""
        words = tuple(word for word, kept in zip(self.word, chosen, strict=True) if kept)
        return Errors(self.seconds[chosen], self.off[chosen], self.covariance[chosen], words)


@dataclass(frozen=True, slots=True, eq=False)
class Localized:
    """One drive. `levels`: of the estimated road and of the true one, (n, 2), NaN where unknown; `seam_m`: metres of
    the way (n,) to the next change of the true level: there the same surface has two names. `elevation_m`: errors (n,)
    of the road's. `sweep_s`: processor time of each sweep from hearing it to its match."""

    name: str
    poses: Errors
    matches: Errors
    levels: Floats
    seam_m: Floats
    elevation_m: Floats
    sweep_s: Floats
    tally: IssueTally

    @property
    def wrong_level(self) -> NDArray[np.bool_]:
        """Where (n,) another level than the true one was estimated, not at a seam, or its elevation is another
        road's."""
        other = np.isfinite(self.levels[:, 0]) & (self.levels[:, 0] != self.levels[:, 1])
        return (other & (self.seam_m > SEAM_M)) | (np.abs(self.elevation_m) > OTHER_ROAD_M)


def options_of_car(**more: Any) -> LocalizationOptions:
    """The localizer's parameters for the simulated car."""
    settings = LocalizerSettings(
        antenna_x_m=CAR.antenna[0],
        antenna_y_m=CAR.antenna[1],
        antenna_z_m=CAR.antenna[2],
        lidar_x_m=CAR.lidar[0],
        lidar_y_m=CAR.lidar[1],
        lidar_z_m=CAR.lidar[2],
        wheelbase_m=CAR.wheelbase_m,
        **more,
    )
    return settings.options(settings.initial_pose)


def localized(drive: KeptDrive, *, lidar: bool = True, given: float = 1.0) -> Localized:
    """The localizer over a drive from its given pose, whose error and σ are this share of what they were."""
    options = options_of_car(initial_pose=_nearer(drive, given).model_dump(), match_sweeps=lidar)
    tally = IssueTally()
    localization = Localization(options, LocalMapQueries(read_release(drive.map_folder)), tally)
    poses: list[Pose] = []
    matches: list[ScanMatch] = []
    sweep_s = []
    for tick in drive.ticks:
        began_s = time.process_time()
        if tick.motion is not None:
            localization.on_motion(tick.motion)
        if tick.sweep is not None:
            localization.on_sweep(tick.sweep)
        step = localization.advance()
        if step.matches:
            sweep_s.append((time.process_time() - began_s) / len(step.matches))
        matches += step.matches
        if step.pose is not None and step.pose.latitude_rad is not None:
            poses.append(step.pose)
    end_ns = int(drive.truth.time_ns[-1])
    poses = [pose for pose in poses if pose.time_ns <= end_ns]
    return _compared_with_truth(drive, poses, matches, np.array(sweep_s), tally)


def _nearer(drive: KeptDrive, share: float) -> InitialPose:
    """The given pose with a share of its error, and σ to match: of the first motion sample, where it is believed. A
    vehicle that drives is a metre on by then."""
    truth, given = drive.truth, drive.given
    begin = np.array([next(tick.time_ns for tick in drive.ticks if tick.motion is not None)])

    def between(column: Floats, given_deg: float) -> float:
        off_rad = wrap_pi(math.radians(given_deg) - float(column[0]))
        return math.degrees(float(_at(truth, column, begin)[0]) + share * off_rad)

    return InitialPose(
        latitude_deg=between(truth.antenna_latitude_rad, given.latitude_deg),
        longitude_deg=between(truth.antenna_longitude_rad, given.longitude_deg),
        yaw_deg=between(np.unwrap(truth.yaw_rad), given.yaw_deg),
        horizontal_sigma_m=share * given.horizontal_sigma_m,
        yaw_sigma_deg=share * given.yaw_sigma_deg,
    )


def matched_alone(drive: KeptDrive, *, every: int = ALONE_EVERY) -> Errors:
    """A drive's matches without the filter: nothing but each sweep's own neighbours and the true level are known."""
    options = options_of_car()
    assert options.matching is not None
    truth = drive.truth
    blindfold = _Blindfold(options, drive, every)
    matcher = ScanMatcher(
        options.matching, blindfold, LocalMapQueries(read_release(drive.map_folder)), IssueTally()
    )
    rows: list[tuple[int, str]] = []
    for tick in drive.ticks:
        if tick.motion is not None:
            m = tick.motion
            blindfold.predict(m)
            matcher.set_attitude(m.roll_rad, m.pitch_rad)
        if tick.sweep is not None:
            matcher.add_sweep(tick.sweep)
        k = _row(truth, tick.time_ns)
        matcher.reset_road_height()
        road = Road(status="known", elevation_m=float(truth.road_height_m[k]))
        for match in matcher.process(blindfold.plane, road).matches:
            if blindfold.asked(match.time_ns):
                rows.append((match.time_ns, f"{match.status} {match.reason}".strip()))
    return blindfold.errors(rows)


class _Blindfold(PoseFilter):
    """Dead reckoning whose predictions are near the truth, and takes no match in."""

    def __init__(self, options: LocalizationOptions, drive: KeptDrive, every: int) -> None:
        super().__init__(options.model)
        self._drive, self._every = drive, every
        self._random = stream(drive.drive_seed, "starts of matches")
        first = drive.truth
        self.plane = LocalPlane(float(first.latitude_rad[0]), float(first.longitude_rad[0]))
        sweeps = [tick.time_ns for tick in drive.ticks if tick.sweep is not None]
        self._asked = set(sweeps[every - 1 :: every])
        self._matched: dict[int, tuple[Floats, Floats]] = {}

    def asked(self, time_ns: int) -> bool:
        """Whether this sweep is to be matched."""
        return time_ns in self._asked

    def prediction_at(self, time_ns: int) -> Prediction | None:
        if time_ns not in self._asked:
            return None
        east_m, north_m, yaw_rad = self._true(time_ns)
        direction = self._random.uniform(0.0, math.tau)
        turned = math.copysign(START_OFF_RAD, self._random.uniform(-1.0, 1.0))
        covariance = np.diag([0.5 * START_OFF_M**2, 0.5 * START_OFF_M**2, 0.5 * START_OFF_RAD**2])
        return Prediction(
            time_ns,
            east_m + START_OFF_M * math.cos(direction),
            north_m + START_OFF_M * math.sin(direction),
            wrap_pi(yaw_rad + turned),
            True,
            covariance * 0.8,  # 3 σ is within what is sure
        )

    def match(
        self,
        time_ns: int,
        pose: tuple[float, float, float],
        covariance: Floats,
        *,
        unique: bool,
        overlay_lag: OverlayLag = _NO_LAG,
    ) -> MatchUpdate:
        true_m = self._true(time_ns)
        off = np.array([pose[0] - true_m[0], pose[1] - true_m[1], wrap_pi(pose[2] - true_m[2])])
        self._matched[time_ns] = off, covariance + self.motion_share(overlay_lag, pose[2])
        return MatchUpdate("accepted")

    def errors(self, rows: Sequence[tuple[int, str]]) -> Errors:
        """Of the matches (time, word) that it received; the others are lost."""
        matched = [(time_ns, word) for time_ns, word in rows if time_ns in self._matched]
        lost = [word for time_ns, word in rows if time_ns not in self._matched]
        times_ns = np.array([time_ns for time_ns, _ in matched], np.int64)
        off = np.array([self._matched[time_ns][0] for time_ns, _ in matched]).reshape(-1, 3)
        covariance = np.array([self._matched[time_ns][1] for time_ns, _ in matched]).reshape(-1, 3, 3)
        n = len(lost)
        away = _turned(_columns(self._drive.truth, times_ns)[2], off, covariance)
        return Errors(
            np.append((times_ns - self._drive.truth.time_ns[0]) * 1e-9, np.full(n, np.nan)),
            np.concatenate([away[0], np.full((n, 3), np.nan)]),
            np.concatenate([away[1], np.tile(np.eye(3), (n, 1, 1))]),
            (*(word for _, word in matched), *lost),
        )

    def _true(self, time_ns: int) -> tuple[float, float, float]:
        truth = self._drive.truth
        at = np.array([time_ns])
        latitude, longitude, yaw = _columns(truth, at)
        return *self.plane.east_north(float(latitude[0]), float(longitude[0])), float(yaw[0])


# Beside the truth


def _compared_with_truth(
    drive: KeptDrive, poses: list[Pose], matches: list[ScanMatch], sweep_s: Floats, tally: IssueTally
) -> Localized:
    truth, frame = drive.truth, _frame(drive.truth)
    times_ns = np.array([p.time_ns for p in poses], np.int64)
    rows = np.array([_row(truth, int(t)) for t in times_ns], np.int64)
    here = np.array([frame.east_north_from_geodetic(p.latitude_rad, p.longitude_rad, 0.0)[:2] for p in poses])
    yaw = _at(truth, np.unwrap(truth.yaw_rad), times_ns)
    true = frame.east_north_from_geodetic_array(
        _at(truth, truth.antenna_latitude_rad, times_ns),
        _at(truth, truth.antenna_longitude_rad, times_ns),
        np.zeros(len(poses)),
    )
    turned = [
        math.nan if p.yaw_rad is None else wrap_pi(p.yaw_rad - y) for p, y in zip(poses, yaw, strict=True)
    ]
    off, covariance = _turned(
        yaw,
        np.column_stack([here - true, turned]),
        np.array([_full(p.covariance_east_north_yaw) for p in poses]),
    )
    seconds = (times_ns - truth.time_ns[0]) * 1e-9
    levels = [math.nan if p.road.level is None else float(p.road.level) for p in poses]
    elevation = [math.nan if p.road.elevation_m is None else p.road.elevation_m for p in poses]
    return Localized(
        drive.name,
        Errors(seconds, off, covariance, tuple(p.mode for p in poses)),
        _of_matches(drive, matches, frame),
        np.column_stack([levels, truth.level[rows]]),
        _to_seam(truth)[rows],
        np.array(elevation) - _at(truth, truth.road_height_m, times_ns),
        sweep_s,
        tally,
    )


def _to_seam(truth: DriveTruth) -> Floats:
    """Metres (n,) of the way to the next change of level, before or behind."""
    seams = truth.driven_m[1:][np.diff(truth.level) != 0]
    if not len(seams):
        return np.full(len(truth.level), np.inf)
    return np.abs(truth.driven_m[:, None] - seams).min(axis=1)


def _of_matches(drive: KeptDrive, matches: list[ScanMatch], frame: LocalFrame) -> Errors:
    """Of the sensor's place, where there is one."""
    truth = drive.truth
    rows, words = [], []
    for m in matches:
        words.append(f"{m.status} {m.reason}".strip())
        if m.latitude_rad is None or m.longitude_rad is None or m.covariance_east_north is None:
            rows.append((m.time_ns, *[math.nan] * 3, 1.0, 0.0, 1.0))
            continue
        assert m.roll_pitch_yaw_rad is not None
        here = frame.east_north_from_geodetic(m.latitude_rad, m.longitude_rad, 0.0)[:2]
        rows.append((m.time_ns, *here, m.roll_pitch_yaw_rad[2], *m.covariance_east_north))
    if not rows:
        return Errors(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)), ())
    table = np.array([row[1:] for row in rows])
    times_ns = np.array([row[0] for row in rows], np.int64)
    latitude, longitude, yaw = _columns(truth, times_ns)
    true = frame.east_north_from_geodetic_array(latitude, longitude, np.zeros(len(rows)))
    pitch, roll = _at(truth, truth.pitch_rad, times_ns), _at(truth, truth.roll_rad, times_ns)
    x, y, z = CAR.lidar
    ahead = x * np.cos(pitch) + z * np.sin(pitch)
    left = y * np.cos(roll) - z * np.sin(roll)
    true += np.column_stack(
        [ahead * np.cos(yaw) - left * np.sin(yaw), ahead * np.sin(yaw) + left * np.cos(yaw)]
    )
    off = np.column_stack([table[:, :2] - true, np.remainder(table[:, 2] - yaw + np.pi, math.tau) - np.pi])
    covariance = np.zeros((len(rows), 3, 3))
    covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 0], covariance[:, 1, 1] = table[
        :, [3, 4, 4, 5]
    ].T
    off, covariance = _turned(yaw, off, covariance)
    covariance[:, 2, 2] = math.nan
    return Errors((times_ns - truth.time_ns[0]) * 1e-9, off, covariance, tuple(words))


def _frame(truth: DriveTruth) -> LocalFrame:
    return LocalFrame(float(truth.latitude_rad[0]), float(truth.longitude_rad[0]), 0.0)


def _row(truth: DriveTruth, time_ns: int) -> int:
    return int(np.clip(round((time_ns - int(truth.time_ns[0])) / 1e7), 0, len(truth.time_ns) - 1))


def _at(truth: DriveTruth, column: Floats, time_ns: Integers) -> Floats:
    begin = truth.time_ns[0]
    return np.interp((time_ns - begin) * 1e-9, (truth.time_ns - begin) * 1e-9, column)


def _columns(truth: DriveTruth, time_ns: Integers) -> tuple[Floats, Floats, Floats]:
    """Latitude, longitude and yaw of the vehicle frame's origin."""
    return (
        _at(truth, truth.latitude_rad, time_ns),
        _at(truth, truth.longitude_rad, time_ns),
        _at(truth, np.unwrap(truth.yaw_rad), time_ns),
    )


def _turned(yaw_rad: Floats, off: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Errors (n, 3) and covariances (n, 3, 3) of east, north, yaw as of along, left, yaw."""
    turn = np.zeros((len(yaw_rad), 3, 3))
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = cos, sin, -sin, cos, 1.0
    return np.einsum("nij,nj->ni", turn, off), turn @ covariance @ turn.transpose(0, 2, 1)


def _full(upper: tuple[float, ...] | None) -> Floats:
    assert upper is not None
    a, b, c, d, e, f = upper
    return np.array([[a, b, c], [b, d, e], [c, e, f]])
