"""How far off the independent position is in simulated drives, and whether its covariance says so.

PYTHONPATH=tests python -m support.independent_statistics city --seeds 1 2 3 --seconds 60
PYTHONPATH=tests python -m support.independent_statistics open-sky canyon --seeds 1 2 3 --no-lidar --given 0.3

Whole routes, or --seconds of them, from a given pose. Confirmed positions anchor the pose once a second; --away leads
them away by so much a second: the independent position must not see it. One row of the table for all epochs within a
range of the distance driven since the last evidence; intervals are of a bootstrap that draws whole drives.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from camber.localizer.localization import Localization
from camber.schemas.integrity import Verdict
from camber.schemas.pose import Pose
from camber.simulator.scene import Floats
from camber.tools.localize.local_map_queries import LocalMapQueries
from camber.tools.localize.localizer_run import IssueTally
from support.lidar_drives import NS, LidarDrive, lidar_drive, route_duration_s
from support.localization_drives import options_of_car
from support.localization_statistics import ELLIPSE_99, share_and_interval

BOUNDS_M = (0.0, 20.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 1e9)
ANCHOR_M = 0.02


class IndependentErrors(NamedTuple):
    """One drive, rows (n,): errors along and to the left [m], σ of them, the squared error by the covariance, the
    distance since the last evidence; the pose's own horizontal error, and how often the basis was a match."""

    along_m: Floats
    left_m: Floats
    along_sigma_m: Floats
    left_sigma_m: Floats
    squared: Floats
    since_m: Floats
    pose_m: Floats
    matched: float


def independent_errors(drive: LidarDrive, *, lidar: bool, given: float, away_m_s: float) -> IndependentErrors:
    """Run the localizer over a drive, from a pose given with this σ in m and 2° times it."""
    start = drive.given_pose(given, math.radians(2.0) * min(given, 1.0)).model_dump()
    options = options_of_car(initial_pose=start, match_sweeps=lidar)
    localization = Localization(options, LocalMapQueries(drive.map_release), IssueTally())
    rows, bases, anchored_s = [], [], 0
    for tick in drive.ticks(sweeps=lidar):
        if tick.motion is not None:
            localization.on_motion(tick.motion)
            if tick.time_ns // NS != anchored_s:
                anchored_s = tick.time_ns // NS
                localization.on_verdict(confirmed(drive, tick.time_ns, away_m_s))
        if tick.sweep is not None:
            localization.on_sweep(tick.sweep)
        pose = localization.advance().pose
        if pose is not None and pose.independent is not None and pose.time_ns <= drive.end_ns:
            rows.append(_row(drive, pose))
            bases.append(pose.independent.basis)
    return IndependentErrors(
        *np.array(rows).T, matched=sum(basis == "scan_match" for basis in bases) / len(bases)
    )


def confirmed(drive: LidarDrive, time_ns: int, away_m_s: float) -> Verdict:
    """A confirmed position of the antenna at a time, led away to the north-east."""
    truth = drive.truth_at(np.array([time_ns]))
    away_m = away_m_s * (time_ns - drive.start_ns) * 1e-9 / math.sqrt(2.0)
    latitude, longitude, height = drive.frame.geodetic_from_east_north(
        float(truth.antenna_m[0, 0]) + away_m, float(truth.antenna_m[0, 1]) + away_m, 0.0
    )
    return Verdict(
        time_ns=time_ns,
        fix_id=time_ns // NS,
        verdict="confirmed",
        reason="none",
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=height,
        covariance_enu_m2=(ANCHOR_M**2, 0.0, 0.0, ANCHOR_M**2, 0.0, ANCHOR_M**2),
    )


def _row(drive: LidarDrive, pose: Pose) -> tuple[float, ...]:
    position, truth = pose.independent, drive.truth_at(np.array([pose.time_ns]))
    assert position is not None
    off = np.array(_east_north(drive, position.latitude_rad, position.longitude_rad)) - truth.antenna_m[0, :2]
    assert pose.latitude_rad is not None
    assert pose.longitude_rad is not None
    pose_off = np.array(_east_north(drive, pose.latitude_rad, pose.longitude_rad)) - truth.antenna_m[0, :2]
    ee, en, nn = position.covariance_east_north
    covariance, yaw = np.array([[ee, en], [en, nn]]), float(truth.yaw_rad[0])
    along, left = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
    return (
        float(along @ off),
        float(left @ off),
        math.sqrt(float(along @ covariance @ along)),
        math.sqrt(float(left @ covariance @ left)),
        float(off @ np.linalg.solve(covariance, off)),
        position.distance_m,
        math.hypot(*pose_off),
    )


def _east_north(drive: LidarDrive, latitude_rad: float, longitude_rad: float) -> tuple[float, float]:
    return drive.frame.east_north_from_geodetic(latitude_rad, longitude_rad, 0.0)


def table(drives: Sequence[IndependentErrors]) -> Iterator[str]:
    """One line for each range of the distance since the last evidence, and one for all."""
    yield "since [m] | epochs | along p95, σ median [m] | left p95, σ median [m] | NEES mean | in 99 % ellipse"
    for low, high in [*pairwise(BOUNDS_M), (0.0, math.inf)]:
        chosen = [(d.since_m >= low) & (d.since_m < high) for d in drives]
        if not any(rows.any() for rows in chosen):
            continue

        def all_of(name: str, chosen: Sequence[Floats] = tuple(chosen)) -> Floats:
            return np.concatenate([getattr(d, name)[rows] for d, rows in zip(drives, chosen, strict=True)])

        inside = share_and_interval(
            [d.squared[rows] <= ELLIPSE_99 for d, rows in zip(drives, chosen, strict=True)]
        )
        label = "all" if high == math.inf else f"{low:.0f} to {high:.0f}" if high < 1e9 else f"{low:.0f} on"
        along, left = (float(np.quantile(np.abs(all_of(f"{side}_m")), 0.95)) for side in ("along", "left"))
        sigmas = [float(np.median(all_of(f"{side}_sigma_m"))) for side in ("along", "left")]
        yield (
            f"{label} | {len(all_of('squared'))} | {along:.2f}, {sigmas[0]:.2f} | {left:.2f}, {sigmas[1]:.2f}"
            f" | {all_of('squared').mean():.2f} | {100 * inside['in_ellipse_99']:.1f} %"
            f" ({100 * inside['from']:.1f} to {100 * inside['to']:.1f})"
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenarios", nargs="+")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--start", type=float, default=3.0, help="seconds after the route's beginning")
    parser.add_argument("--seconds", type=float, help="of a drive; without it the whole route")
    parser.add_argument("--route", default="default")
    parser.add_argument("--rounds", type=int, default=1, help="of a route that ends where it begins")
    parser.add_argument(
        "--given", type=float, default=0.3, help="σ of the given pose in m; its yaw: 2° times it"
    )
    parser.add_argument(
        "--away", type=float, default=0.0, help="m/s that confirmed positions are led away by"
    )
    parser.add_argument("--no-lidar", action="store_true")
    args = parser.parse_args()
    drives = []
    for scenario in args.scenarios:
        for seed in tqdm(args.seeds):
            longest = route_duration_s(scenario, seed, args.route, args.rounds) - args.start - 1.0
            seconds = min(longest, args.seconds or math.inf)
            drive = lidar_drive(
                scenario,
                seed,
                start_s=args.start,
                duration_s=math.floor(seconds),
                route=args.route,
                rounds=args.rounds,
            )
            drives.append(
                independent_errors(drive, lidar=not args.no_lidar, given=args.given, away_m_s=args.away)
            )
            last = drives[-1]
            tqdm.write(
                f"{drive.name}: matched {last.matched:.2f}, pose off {last.pose_m.max():.2f} m at most, "
                f"independent {np.hypot(last.along_m, last.left_m).max():.2f} m"
            )
    print("\n".join(table(drives)))


if __name__ == "__main__":
    main()
