"""A made-up street driven along, sweeps and all, through the localizer without a bus."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from camber.localizer.given_pose import GivenPose
from camber.localizer.localization import Localization, LocalizationOptions
from camber.localizer.matching.scan_matcher import ScanMatchOptions
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.localizer.warm_up import SyntheticMap, synthetic_street
from camber.road_map.tile_grid import tile_frame
from camber.schemas.gnss import Fix
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Motion
from camber.schemas.pose import Pose, ScanMatch
from camber.tools.localize.localizer_run import IssueTally

NS = 1_000_000_000
START_NS = 1_400_000_000 * NS
FRAME = tile_frame(57686, 25920)
LIDAR_HEIGHT_M = 1.8
_TURN_NS = NS // 10
_ROAD_M, _WALLS_M = synthetic_street()


def geodetic(east_m: float, north_m: float) -> tuple[float, float]:
    latitude_rad, longitude_rad, _ = FRAME.geodetic_from_east_north(east_m, north_m, 0.0)
    return latitude_rad, longitude_rad


def east_north(latitude_rad: float, longitude_rad: float) -> tuple[float, float]:
    return FRAME.east_north_from_geodetic(latitude_rad, longitude_rad, 0.0)


class StreetDrive:
    """East along the street's middle at an even speed, from `begin_m`; the antenna is over the rear axle."""

    def __init__(
        self,
        *,
        begin_m: float = -20.0,
        speed_m_s: float = 5.0,
        off_m: tuple[float, float] = (0.3, 0.2),
        off_rad: float = 0.01,
        sigma_m: float = 0.3,
        given: bool = True,
        mount: SensorMount | None = None,
        seen_m: np.ndarray | None = None,
        answers: Any = None,
        matching: ScanMatchOptions | None = None,
    ) -> None:
        self.begin_m, self.speed_m_s = begin_m, speed_m_s
        self.diagnostics = IssueTally()
        self.answers = answers or SyntheticMap(_ROAD_M, _WALLS_M)
        self.seen_m = np.concatenate((_ROAD_M, _WALLS_M)) if seen_m is None else seen_m
        latitude_rad, longitude_rad = geodetic(begin_m + off_m[0], off_m[1])
        start = GivenPose(
            latitude_deg=math.degrees(latitude_rad),
            longitude_deg=math.degrees(longitude_rad),
            yaw_deg=math.degrees(off_rad),
            horizontal_sigma_m=sigma_m,
            yaw_sigma_deg=1.0,
        )
        mount = mount or SensorMount(x_m=0.0, y_m=0.0, z_m=LIDAR_HEIGHT_M)
        matching = replace(matching or ScanMatchOptions(), mount=mount)
        options = LocalizationOptions(given=start if given else None, matching=matching)
        self.localization = Localization(options, self.answers, self.diagnostics)
        self.tenth = 0
        self.poses: list[Pose] = []
        self.matches: list[ScanMatch] = []

    @property
    def time_ns(self) -> int:
        return START_NS + self.tenth * _TURN_NS

    def at_m(self, time_ns: int) -> float:
        return self.begin_m + self.speed_m_s * (time_ns - START_NS) / NS

    def sweep(self, time_ns: int | None = None) -> Sweep:
        """The turn that ends then; each point from where the sensor was when it was measured."""
        time_ns = self.time_ns if time_ns is None else time_ns
        about = self.seen_m - np.array([self.at_m(time_ns), 0.0, LIDAR_HEIGHT_M])
        about = about[np.hypot(about[:, 0], about[:, 1]) < 40.0]
        share = (np.arctan2(about[:, 1], about[:, 0]) + math.pi) / math.tau
        about[:, 0] += self.speed_m_s * (1.0 - share) * _TURN_NS / NS
        return Sweep(
            time_ns=time_ns,
            sensor="lidar",
            points_m=about.astype(np.float32),
            intensity=np.zeros(len(about), np.float32),
            offset_ns=np.rint((share - 1.0) * _TURN_NS).astype(np.int32),
        )

    def motion(self, **changes: Any) -> Motion:
        values = {"wheel_speed_m_s": self.speed_m_s, "yaw_rate_rad_s": 0.0, "steering_angle_rad": 0.0}
        return Motion(time_ns=self.time_ns, **(values | changes))

    def fix(self, east_m: float, north_m: float) -> Fix:
        latitude_rad, longitude_rad = geodetic(east_m, north_m)
        return Fix(
            time_ns=self.time_ns,
            fix_id=self.tenth,
            origin="receiver",
            quality="fixed",
            latitude_rad=latitude_rad,
            longitude_rad=longitude_rad,
            height_m=51.5,
            covariance_enu_m2=(4e-4, 0.0, 0.0, 4e-4, 0.0, 1e-3),
            satellites=10,
        )

    def run(
        self,
        tenths: int,
        *,
        sweeps: Callable[[Sweep], Iterable[Sweep]] | None = None,
        fixes: Callable[[StreetDrive], Fix | None] | None = None,
        motion: Callable[[StreetDrive], Motion | None] | None = None,
    ) -> Pose:
        """Some tenths of a second; `sweeps` may change, drop or repeat each one."""
        for _ in range(tenths):
            fix = None if fixes is None else fixes(self)
            if fix is not None:
                self.localization.on_fix(fix)
            moved = self.motion() if motion is None else motion(self)
            if moved is not None:
                self.localization.on_motion(moved)
            whole = self.sweep()
            for sweep in [whole] if sweeps is None else sweeps(whole):
                self.localization.on_sweep(sweep)
            step = self.localization.advance()
            self.matches += step.matches
            if step.pose is not None:
                self.poses.append(step.pose)
            self.tenth += 1
        return self.poses[-1]

    def error_m(self, pose: Pose | None = None) -> float:
        """Of the last pose, or of another."""
        pose = pose or self.poses[-1]
        assert pose.latitude_rad is not None
        assert pose.longitude_rad is not None
        east_m, north_m = east_north(pose.latitude_rad, pose.longitude_rad)
        return math.hypot(east_m - self.at_m(pose.time_ns), north_m)

    def sigma_m(self) -> float:
        covariance = self.poses[-1].covariance_east_north_yaw
        assert covariance is not None
        return math.sqrt(max(covariance[0], covariance[3]))
