"""A drive of two minutes, made on the spot: what `make demo` and the tests run on where there is no recording.

One street leads over a hill and under a bridge, turns and climbs, stops at a light, crosses over itself on that
bridge (two levels at one place), comes down, and meets its own beginning again. The receiver gives right fixes,
float stretches, two gaps, and fixes that are wrong by a lattice of whole wavelengths: at the very start, at
standstills, after a gap, on the bridge. All of it is simulated, and the manifest says so; nothing in it is
evidence of performance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from camber.formats.drive.motion_csv import write_samples
from camber.formats.drive.truth_csv import FIX_STATES, TruthTable, write_truth
from camber.formats.receiver.rtklib_pos import format_pos_header, format_pos_line
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.angles import wrap_pi_array
from camber.geodesy.local_frame import LocalFrame
from camber.replay.drive_inputs import write_map
from camber.replay.surrogates import correlated_noise, make_initial_pose, make_motion
from camber.schemas.base import Float64
from camber.schemas.drive import Surrogates
from camber.schemas.motion import Motion
from camber.simulator.random_streams import stream

State = Literal["right", "wrong", "float", "none"]

NAME = "short-drive"
START_NS = 1_400_000_000 * 1_000_000_000  # chosen: a time that no recording here has
DURATION_S = 120.0
"""Chosen, as all numbers of this drive: a test or a demonstration needs no longer one."""
RATE_HZ = 5  # chosen: as the recorded drive of Nagoya
ANTENNA_HEIGHT_M = 1.6  # chosen: on the roof of a car
MAP_SIGMA_M = 0.03  # chosen: a surveyed road

SCHEDULE: tuple[tuple[float, float, State], ...] = (
    (0.0, 3.0, "wrong"),  # from the very start: no history to compare with
    (6.0, 8.4, "wrong"),  # standing
    (20.0, 22.0, "wrong"),
    (24.0, 29.0, "float"),
    (29.0, 33.0, "none"),
    (33.0, 35.4, "wrong"),  # first thing after a gap
    (48.0, 51.0, "wrong"),  # standing at the light
    (63.0, 66.0, "float"),
    (73.0, 76.0, "wrong"),  # on the bridge
    (80.0, 84.0, "float"),
    (88.0, 90.0, "wrong"),
    (96.0, 97.4, "wrong"),
    (100.0, 103.0, "float"),
    (103.0, 105.0, "none"),
)
"""From (inclusive) and to (exclusive) in seconds after the start; otherwise fixes are right."""

_ORIGIN = LocalFrame(math.radians(35.0), math.radians(137.0), 0.0)
_GROUND_M = 40.0  # chosen: about the ellipsoidal height near the coast of Japan
_RADIUS_M = 25.0  # chosen: a street corner taken at 9 m/s
_QUARTER_M = 0.5 * math.pi * _RADIUS_M
# Length and turn (+1 left, −1 right, 0 straight); the seventh crosses over the first.
_STREET: tuple[tuple[float, int], ...] = (
    (180.0, 0), (_QUARTER_M, 1), (30.0, 0), (_QUARTER_M, 1), (55.0, 0), (_QUARTER_M, 1), (110.0, 0),
    (_QUARTER_M, -1), (70.0, 0), (_QUARTER_M, -1), (30.0, 0), (_QUARTER_M, -1), (70.0, 0),
)  # fmt: skip
_STEP_M = 0.1  # chosen: far below the distance of two epochs
_CLOTHOID_M = 8.0  # chosen: about a second of steering
_HILL = (75.0, 165.0, 2.5)
_CLIMB = (200.0, 400.0, 7.0)
_DESCENT = (460.0, 600.0, -7.0)
# Time and speed: stand, drive, stop at the light on the climb, drive, stop.
_SPEED_S = (0.0, 10.0, 14.5, 42.5, 47.0, 56.0, 60.5, 109.1, 113.6, 120.0)
_SPEED_M_S = (0.0, 0.0, 9.0, 9.0, 0.0, 0.0, 9.0, 9.0, 0.0, 0.0)

_WAVELENGTH_M = 0.1903  # GPS L1
_LEAST_WRONG_HEIGHT_M = 0.35  # chosen: beyond the height check's cap (0.3 m)
_LARGEST_WRONG_M = 5.0  # chosen: wrong fixes by a few cycles are metres off
_FIX_SIGMA_M = np.array([0.01, 0.01, 0.02])
_FLOAT_SIGMA_M = np.array([0.4, 0.4, 0.7])


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongEpisode:
    """Seconds after the start, and by how much the fixes of it are off: east, north, up [m]."""

    from_s: float
    to_s: float
    offset_enu_m: tuple[float, float, float]


def write_short_drive(folder: Path, seed: int = 1, *, start_ns: int = START_NS) -> Path:
    """Write the drive's native files, its map and `drive.toml` into a folder; returns the path of the latter.

    The same seed gives the same bytes. Streets and times are the same for every seed, errors are not.
    """
    folder.mkdir(parents=True, exist_ok=True)
    truth = short_drive_truth(start_ns)
    errors = Surrogates(
        allow_smaller_errors=True,
        inputs=("wheel_speed", "yaw_rate", "steering"),
        seed=seed,
        map_sigma_m=MAP_SIGMA_M,
    )
    (folder / "receiver.pos").write_bytes(_receiver_file(truth, seed))
    write_samples(folder / "motion.csv", Motion, make_motion(truth, errors))
    write_truth(folder / "truth.csv", truth)
    write_map(
        folder / "map",
        truth,
        errors,
        ANTENNA_HEIGHT_M,
        region=NAME,
        datum="WGS84",
        surrogate=f"simulated streets, surveyed with {MAP_SIGMA_M:g} m of noise, seed {seed}",
    )
    manifest = folder / "drive.toml"
    manifest.write_bytes(_manifest(truth, errors).encode("utf-8"))
    return manifest


def short_drive_truth(start_ns: int = START_NS) -> TruthTable:
    """Where the antenna is at each epoch, which fixes are made wrong with it."""
    n = round(DURATION_S * RATE_HZ) + 1
    time_s = np.arange(n) / RATE_HZ
    fine_s = np.linspace(0.0, DURATION_S, round(DURATION_S * 100) + 1)
    fine_m_s = np.interp(fine_s, _SPEED_S, _SPEED_M_S)
    fine_m = np.append(0.0, np.cumsum(0.5 * (fine_m_s[1:] + fine_m_s[:-1]) * np.diff(fine_s)))
    along_m = np.interp(time_s, fine_s, fine_m)
    speed_m_s = np.interp(time_s, _SPEED_S, _SPEED_M_S)
    s_m, street_yaw, street_m = _street()
    yaw_rad = np.interp(along_m, s_m, street_yaw)
    plane_m = np.column_stack([np.interp(along_m, s_m, column) for column in street_m.T])
    height_m = _road_height(along_m) + ANTENNA_HEIGHT_M
    grade = (_road_height(along_m + 0.05) - _road_height(along_m - 0.05)) / 0.1
    latitude, longitude, _ = _ORIGIN.geodetic_from_east_north_array(plane_m, height_m)
    states = [_state(t) for t in time_s.tolist()]
    return TruthTable(
        time_ns=start_ns + np.arange(n, dtype=np.int64) * (1_000_000_000 // RATE_HZ),
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=height_m,
        roll_rad=np.zeros(n),
        pitch_rad=-np.arctan(grade),  # nose up is negative about an axis to the left
        yaw_rad=wrap_pi_array(yaw_rad),
        velocity_enu_m_s=np.column_stack((np.cos(yaw_rad), np.sin(yaw_rad), grade)) * speed_m_s[:, None],
        fix_state=np.array(
            [FIX_STATES.index(s if s in ("right", "wrong") else "none") for s in states], dtype=np.int8
        ),
    )


def wrong_episodes(seed: int) -> tuple[WrongEpisode, ...]:
    """When fixes are made wrong and by how much: what wrong integers do to a position, always to its height too."""
    rng = stream(seed, "wrong fixes")
    return tuple(
        WrongEpisode(from_s=begin, to_s=end, offset_enu_m=_lattice_offset(rng))
        for begin, end, state in SCHEDULE
        if state == "wrong"
    )


def _lattice_offset(rng: np.random.Generator) -> tuple[float, float, float]:
    """Least-squares shift of a position whose double-differenced integers are off by a few."""
    while True:
        azimuth = rng.uniform(0.0, 2.0 * np.pi, 8)
        sine = rng.uniform(np.sin(np.deg2rad(15.0)), np.sin(np.deg2rad(85.0)), 8)
        cosine = np.sqrt(1.0 - sine**2)
        to_satellite = np.column_stack((cosine * np.sin(azimuth), cosine * np.cos(azimuth), sine))
        geometry = to_satellite[0] - to_satellite[1:]
        largest = int(rng.integers(2, 7))
        wrong_cycles = rng.integers(-largest, largest + 1, 7)
        shift, *_ = np.linalg.lstsq(geometry, _WAVELENGTH_M * wrong_cycles)
        if abs(shift[2]) >= _LEAST_WRONG_HEIGHT_M and np.linalg.norm(shift) <= _LARGEST_WRONG_M:
            return round(float(shift[0]), 4), round(float(shift[1]), 4), round(float(shift[2]), 4)


def _state(time_s: float) -> State:
    for begin, end, state in SCHEDULE:
        if begin <= round(time_s, 3) < end:
            return state
    return "right"


def _street() -> tuple[Float64, Float64, Float64]:
    """Distance (m,), yaw (m,) and east, north (m, 2) along the street, with curvature that changes gradually."""
    curvature = np.concatenate(
        [np.full(round(length / _STEP_M), turn / _RADIUS_M) for length, turn in _STREET]
    )
    width = round(_CLOTHOID_M / _STEP_M)
    curvature = np.convolve(curvature, np.full(width, 1.0 / width), mode="same")
    yaw_rad = np.append(0.0, np.cumsum(curvature) * _STEP_M)
    middle = 0.5 * (yaw_rad[1:] + yaw_rad[:-1])
    steps = np.column_stack((np.cos(middle), np.sin(middle))) * _STEP_M
    plane_m = np.vstack((np.zeros(2), np.cumsum(steps, axis=0)))
    return np.linspace(0.0, _STEP_M * len(curvature), len(yaw_rad)), np.asarray(yaw_rad, np.float64), plane_m


def _road_height(along_m: Float64) -> Float64:
    """Ellipsoidal height of the road by distance driven."""
    begin, end, rise = _HILL
    inside = (along_m > begin) & (along_m < end)
    height = _GROUND_M + np.where(inside, rise * np.sin(np.pi * (along_m - begin) / (end - begin)) ** 2, 0.0)
    for begin, end, rise in (_CLIMB, _DESCENT):
        share = np.clip((along_m - begin) / (end - begin), 0.0, 1.0)
        height = height + rise * share**2 * (3.0 - 2.0 * share)
    return height


def _receiver_file(truth: TruthTable, seed: int) -> bytes:
    time_s = (truth.time_ns - truth.time_ns[0]) / 1e9
    n = len(truth)

    def correlated(name: str, sigma_m: Float64, correlation_s: float) -> Float64:
        rng = stream(seed, name)
        return np.column_stack(
            [correlated_noise(time_s, float(sigma), correlation_s, rng) for sigma in sigma_m]
        )

    fix_error = correlated("fix noise", _FIX_SIGMA_M, 5.0)
    float_error = correlated("float noise", _FLOAT_SIGMA_M, 15.0)
    episodes = wrong_episodes(seed)
    rng = stream(seed, "receiver")
    ratio, satellites = 2.5 + rng.gamma(2.0, 2.0, n), rng.integers(8, 19, n)
    lines = [format_pos_header()]
    for k in range(n):
        state = _state(float(time_s[k]))
        if state == "none":
            continue
        fixed = state != "float"
        error = fix_error[k] if fixed else float_error[k]
        if state == "wrong":
            at_s = round(float(time_s[k]), 3)
            error = error + np.array(next(e.offset_enu_m for e in episodes if e.from_s <= at_s < e.to_s))
        ee, nn, uu = (float(sigma_m**2) for sigma_m in (_FIX_SIGMA_M if fixed else _FLOAT_SIGMA_M))
        latitude, longitude, height = _moved(truth, k, error)
        solution = ReceiverSolution(
            time_ns=int(truth.time_ns[k]),
            latitude_rad=latitude,
            longitude_rad=longitude,
            height_m=height,
            quality=SolutionQuality.FIX if fixed else SolutionQuality.FLOAT,
            satellites=int(satellites[k]),
            covariance_enu_m2=(ee, 0.0, 0.0, nn, 0.0, uu),
            age_s=float(time_s[k] % 1.0),
            ratio=float(ratio[k]) if fixed else 1.0 + 0.5 * float(rng.random()),
        )
        lines.append(format_pos_line(solution))
    return b"".join(lines)


def _moved(truth: TruthTable, k: int, error_enu_m: Float64) -> tuple[float, float, float]:
    frame = LocalFrame(float(truth.latitude_rad[k]), float(truth.longitude_rad[k]), float(truth.height_m[k]))
    east, north, up = error_enu_m.tolist()
    return frame.geodetic_from_enu(east, north, up)


def _manifest(truth: TruthTable, errors: Surrogates) -> str:
    pose = make_initial_pose(truth.rows(slice(0, 1)), errors)
    return f"""\
# A simulated drive of two minutes, seed {errors.seed}, as `camber.replay.short_drive` makes it.
name = "{NAME}"
description = "simulated street with a hill, a bridge over itself and two stops"
vehicle = "demo"
simulated = true
datum = "WGS84"

[receiver]
format = "pos"
file = "receiver.pos"

[motion]
file = "motion.csv"

[map]
release = "map"

[truth]
format = "camber"
file = "truth.csv"

[lever_arms.antenna]
z_m = {ANTENNA_HEIGHT_M}

[antenna_height]
way = "fixed"
height_m = {ANTENNA_HEIGHT_M}
sigma_m = 0.02

[initial_pose]
latitude_deg = {pose.latitude_deg:.9f}
longitude_deg = {pose.longitude_deg:.9f}
yaw_deg = {pose.yaw_deg:.4f}
horizontal_sigma_m = {pose.horizontal_sigma_m}
yaw_sigma_deg = {pose.yaw_sigma_deg:.6g}
"""
