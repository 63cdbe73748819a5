"""Dead reckoning and the link filter through the tunnel: 950 seconds without satellites and without LiDAR.

PYTHONPATH=tests python -m support.tunnel_statistics --seeds 1 2 3
PYTHONPATH=tests python -m support.tunnel_statistics --seeds 1 2 3 --slip
PYTHONPATH=tests python -m support.tunnel_statistics --seeds 1 2 3 --automotive

The scenario `tunnel-950s` with the seeds named: its motion, its map's links and its truth, nothing else. Before the
tunnel confirmed fixes anchor the pose and teach the sensors, from the first covered place on there is nothing. Figures
are of the 950 seconds from there. --slip: the wheels spin (factor 1.3, 4 s) or slide (0.6, 2 s) every other minute.
--automotive: the yaw-rate sensor has all the errors of a real one.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from camber.geodesy.angles import wrap_pi_array
from camber.geodesy.local_frame import LocalFrame
from camber.localizer.filter.odometry import MotionModel
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.links.link_matching import LinkMatcher, LinkNetwork, RoadLink
from camber.road_map.release import read_release
from camber.road_map.road_columns import RoadLinks
from camber.schemas.motion import Motion
from camber.simulator.injected_faults import WheelSlip
from camber.simulator.random_streams import stream
from camber.simulator.scenario import load_scenario
from camber.simulator.scene import Trajectory
from camber.simulator.simulated_drive import district_of, sensors_of
from camber.simulator.vehicle.body import CAR
from camber.simulator.vehicle.motion import drive
from camber.simulator.vehicle.sensors import motion_messages, read_sensors
from camber.simulator.world.survey import SURVEYED_BEFORE_NS, SurveyErrors, write_survey

Floats = NDArray[np.float64]

BLIND_S = 950.0
ANCHOR_S = 0.2
ANCHOR_M = 0.02
ELLIPSE_99 = 9.21
SLIPS = ((1.3, 4.0), (0.6, 2.0))


@dataclass(frozen=True, slots=True, eq=False)
class TunnelDrive:
    """Motion, links in the world's plane, truth, and when the satellites are lost."""

    seed: int
    motion: list[Motion]
    links: list[RoadLink]
    trajectory: Trajectory
    lost_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Blind:
    """Epochs without satellites, columns (n,): errors along and across the way, the error of the yaw, the square of
    the position's error by its covariance, the larger sigma, the link's own deviation from its road, the way driven
    since the last anchor, whether a link was matched."""

    along_m: Floats
    across_m: Floats
    yaw_rad: Floats
    squared: Floats
    sigma_m: Floats
    deviation_m: Floats
    driven_m: Floats
    matched: NDArray[np.bool_]

    def figures(self) -> dict[str, float]:
        """Of one drive."""
        horizontal = np.hypot(self.along_m, self.across_m)
        far = self.driven_m > 500.0
        return {
            "epochs": len(horizontal),
            "driven_m": float(self.driven_m[-1]),
            "horizontal_max_m": float(horizontal.max()),
            "horizontal_last_m": float(horizontal[-1]),
            "across_p95_m": float(np.quantile(np.abs(self.across_m), 0.95)),
            "deviation_p95_m": float(np.quantile(self.deviation_m, 0.95)),
            "across_within_deviation_plus_1m": float(
                np.mean(np.abs(self.across_m) <= self.deviation_m + 1.0)
            ),
            "along_p95_m": float(np.quantile(np.abs(self.along_m), 0.95)),
            "along_share_p95": float(np.quantile(np.abs(self.along_m[far]) / self.driven_m[far], 0.95)),
            "along_share_max": float((np.abs(self.along_m[far]) / self.driven_m[far]).max()),
            "yaw_p95_deg": math.degrees(float(np.quantile(np.abs(self.yaw_rad), 0.95))),
            "in_ellipse_99": float(np.mean(self.squared <= ELLIPSE_99)),
            "squared_mean": float(self.squared.mean()),
            "squared_max": float(self.squared.max()),
            "sigma_median_m": float(np.median(self.sigma_m)),
            "matched": float(np.mean(self.matched)),
        }


def tunnel_drive(
    seed: int, *, slip: bool = False, automotive: bool = False, duration_s: float | None = None
) -> TunnelDrive:
    """The scenario's drive with this seed."""
    sensor = "automotive" if automotive else "plain"
    scenario = load_scenario("tunnel-950s", [f"seed={seed}", f"yaw_rate_sensor='{sensor}'"])
    district = district_of(scenario)
    path = district.path()
    faults = _slips(seed, scenario.duration_s) if slip else []
    trajectory = drive(
        path, CAR, start_ns=scenario.start_ns, duration_s=duration_s or scenario.duration_s, faults=faults
    )
    readings = read_sensors(trajectory, CAR, path.surface_m, sensors_of(scenario), seed)
    covered = np.column_stack((path.east_m, path.north_m))[int(np.argmax(path.tunnel))]
    lost = int(np.argmin(np.hypot(*(trajectory.origin_m[:, :2] - covered).T)[: 100 * 100]))
    with tempfile.TemporaryDirectory() as folder:
        errors = SurveyErrors(clouds=False)
        write_survey(Path(folder), district, scenario.start_ns - SURVEYED_BEFORE_NS, errors)
        links = _links(read_release(Path(folder)).road_links(), district.frame)
    return TunnelDrive(seed, motion_messages(readings), links, trajectory, int(trajectory.time_ns[lost]))


def blind(
    one: TunnelDrive,
    model: PoseModel | None = None,
    *,
    couple_links: bool = True,
    steering: bool = True,
    blind_s: float = BLIND_S,
) -> Blind:
    """Run the filter over a drive, and judge it where it has no satellites."""
    model = replace(model or model_of_car(), couple_links=couple_links)
    pose_filter = PoseFilter(model)
    matcher = LinkMatcher(LinkNetwork(one.links))
    rng = stream(one.seed, "anchors of the tunnel")
    anchored_ns, rows = 0, []
    for motion in one.motion:
        now = motion.time_ns
        if now > one.lost_ns + blind_s * 1e9:
            break
        pose_filter.predict(motion if steering else motion.model_copy(update={"steering_angle_rad": None}))
        if now <= one.lost_ns and now - anchored_ns >= ANCHOR_S * 1e9:
            anchored_ns = now
            antenna = _at(one.trajectory, one.trajectory.antenna_m, now)[:2] + rng.normal(0.0, ANCHOR_M, 2)
            pose_filter.anchor(now, float(antenna[0]), float(antenna[1]), np.eye(2) * ANCHOR_M**2)
        e = pose_filter.estimate()
        if e is None:
            continue
        match = matcher.step(
            (e.east_m, e.north_m, e.yaw_rad), e.covariance, travelled_m=pose_filter.travelled_m
        )
        pose_filter.couple_link(match)
        e = pose_filter.estimate()
        if now > one.lost_ns and e is not None:
            off = np.array([e.east_m, e.north_m]) - _at(one.trajectory, one.trajectory.origin_m, now)[:2]
            covariance = e.covariance[:2, :2]
            squared = float(off @ np.linalg.solve(covariance, off))
            rows.append((now, *off, e.yaw_rad, squared, e.horizontal_sigma_m, e.link.status == "matched"))
    return _judged(one, np.array(rows))


def model_of_car(**motion: float) -> PoseModel:
    """The filter's parameters for the simulated car."""
    return PoseModel(
        motion=MotionModel(wheelbase_m=CAR.wheelbase_m, **motion),
        antenna_x_m=CAR.antenna[0],
        antenna_y_m=CAR.antenna[1],
    )


def _judged(one: TunnelDrive, rows: Floats) -> Blind:
    t = one.trajectory
    time_ns = rows[:, 0].astype(np.int64)
    at = np.searchsorted(t.time_ns, time_ns)
    at = np.minimum(at, len(t.time_ns) - 1)
    yaw = t.yaw_rad[at]
    along = rows[:, 1] * np.cos(yaw) + rows[:, 2] * np.sin(yaw)
    across = -rows[:, 1] * np.sin(yaw) + rows[:, 2] * np.cos(yaw)
    driven = np.append(0.0, np.cumsum(0.5 * (t.speed_m_s[1:] + t.speed_m_s[:-1]) * np.diff(t.time_ns) * 1e-9))
    since = driven[at] - np.interp(one.lost_ns, t.time_ns, driven)
    by_id = {link.link_id: link for link in one.links}
    deviation = np.array(
        [
            abs(_offset(by_id[int(t.link_id[k])], t.origin_m[k, :2], t.yaw_rad[k]) - t.link_offset_m[k])
            for k in at.tolist()
        ]
    )
    return Blind(
        along,
        across,
        wrap_pi_array(rows[:, 3] - yaw),
        rows[:, 4],
        rows[:, 5],
        deviation,
        since,
        rows[:, 6] > 0.5,
    )


def _offset(link: RoadLink, place_m: Floats, yaw_rad: float) -> float:
    """How far left of the link, seen along the way, a place is."""
    a, b = link.vertices_m[:-1], link.vertices_m[1:]
    step = b - a
    share = np.clip(np.sum((place_m - a) * step, axis=1) / np.sum(step**2, axis=1), 0.0, 1.0)
    away = place_m - a - share[:, None] * step
    k = int(np.argmin(np.hypot(*away.T)))
    return float(-away[k, 0] * math.sin(yaw_rad) + away[k, 1] * math.cos(yaw_rad))


def _at(t: Trajectory, column_m: Floats, time_ns: int) -> Floats:
    """A column (n, 3) at a time."""
    seconds = (t.time_ns - t.time_ns[0]) * 1e-9
    return np.array([np.interp((time_ns - t.time_ns[0]) * 1e-9, seconds, c) for c in column_m.T])


def _links(table: RoadLinks, frame: LocalFrame) -> list[RoadLink]:
    links = []
    for i, vertices in enumerate(table.vertices):
        plane = frame.east_north_from_geodetic_array(vertices[:, 0], vertices[:, 1], np.zeros(len(vertices)))
        links.append(
            RoadLink(
                link_id=int(table.link_id[i]),
                start_node=int(table.start_node[i]),
                end_node=int(table.end_node[i]),
                vertices_m=plane,
                level=int(table.level[i]),
                sigma_m=float(table.sigma_m[i]),
            )
        )
    return links


def _slips(seed: int, duration_s: float) -> list[WheelSlip]:
    """Every other minute, at a time drawn."""
    rng = stream(seed, "slips of the tunnel")
    onsets = np.arange(90.0, duration_s - 60.0, 120.0)
    return [
        WheelSlip(kind="wheel_slip", factor=factor, onset_s=onset, end_s=onset + lasts_s)
        for k, onset in enumerate((onsets + rng.uniform(0.0, 60.0, len(onsets))).tolist())
        for factor, lasts_s in [SLIPS[k % len(SLIPS)]]
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--slip", action="store_true", help="the wheels spin and slide now and then")
    parser.add_argument("--automotive", action="store_true", help="a real yaw-rate sensor's errors")
    chosen = parser.parse_args()
    for seed in tqdm(chosen.seeds):
        began = time.monotonic()
        one = tunnel_drive(seed, slip=chosen.slip, automotive=chosen.automotive)
        for name, couple in (("alone", False), ("coupled", True)):
            figures = {k: round(v, 4) for k, v in blind(one, couple_links=couple).figures().items()}
            print(
                json.dumps(
                    {"seed": seed, "links": name, **figures, "took_s": round(time.monotonic() - began)}
                )
            )


if __name__ == "__main__":
    main()
