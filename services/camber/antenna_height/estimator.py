"""The antenna's height from all that is heard of a vehicle: the whole of this service without a bus."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from camber.antenna_height.available_heights import Sensors, Vehicle, heights_at, road_of
from camber.antenna_height.flatness import Flatness, FlatRules
from camber.antenna_height.method_comparison import Comparison, ComparisonRules, References
from camber.antenna_height.method_selection import antenna_height, chosen_way
from camber.schemas.antenna import AntennaHeight, HeightMethod
from camber.schemas.motion import Motion, Ranging, Suspension
from camber.schemas.pose import Pose, ScanMatch

_DRIVING_M_S = 1.0


@dataclass(frozen=True, slots=True)
class AntennaOptions:
    """`way`: whose height is passed on."""

    vehicle: Vehicle
    way: HeightMethod | Literal["automatic"] = "fixed"
    comparison: ComparisonRules = field(default_factory=ComparisonRules)
    flat: FlatRules = field(default_factory=FlatRules)


class Said(NamedTuple):
    """A height, and what an operator should know."""

    height: AntennaHeight
    problems: tuple[str, ...]


class Antenna:
    """One vehicle's. `earlier`: how its ways differed in drives before this one."""

    def __init__(self, options: AntennaOptions, earlier: References | None = None) -> None:
        self._options = options
        self._sensors = Sensors()
        self._comparison = Comparison(options.comparison, earlier)
        self._flatness = Flatness(options.flat, _reach_m(options.vehicle))
        self._way: HeightMethod | None = None

    def hear_motion(self, motion: Motion) -> None:
        """Attitude and speed."""
        self._sensors.motion.hear(motion)

    def hear_pose(self, pose: Pose) -> None:
        """The road's slope."""
        self._sensors.pose.hear(pose)
        road = road_of(pose, self._options.vehicle.pose_sigma_limit_m)
        self._flatness.hear(pose.time_ns, road, pose.speed_m_s)

    def hear_suspension(self, suspension: Suspension) -> None:
        """A stroke height."""
        self._sensors.suspension.hear(suspension)

    def hear_ranging(self, ranging: Ranging) -> None:
        """A distance to the road."""
        self._sensors.ranging.hear(ranging)

    def hear_match(self, match: ScanMatch) -> None:
        """A surround sensor's height."""
        self._sensors.match.hear(match)

    @property
    def references(self) -> References:
        """How its ways differ, for the next drive."""
        return self._comparison.references

    @property
    def source_time_ns(self) -> int:
        """When the newest measurement of the way that is passed on was made; zero: it is not measured."""
        way = self._way if self._options.way == "automatic" else self._options.way
        match way:
            case "stroke":
                return self._sensors.suspension.time_ns
            case "ranging" if self._options.vehicle.ranging is not None:
                return self._sensors.ranging.time_ns
            case "ranging" | "scan_matching":
                return self._sensors.match.time_ns
            case _:
                return 0

    def height(self, now_ns: int) -> Said:
        """What is known now."""
        heights = heights_at(now_ns, self._options.vehicle, self._sensors)
        speed_m_s = self._sensors.speed_m_s(now_ns)
        driving = speed_m_s is not None and abs(speed_m_s) > _DRIVING_M_S
        self._comparison.test(now_ns, heights.all(), driving=driving)
        self._way, reason = chosen_way(self._options.way, heights, self._flatness)
        disagreement = self._comparison.text(now_ns)
        said = antenna_height(now_ns, self._way, reason, heights, disagreement)
        return Said(said, tuple(heights.problems))


def _reach_m(vehicle: Vehicle) -> float:
    """About how far, level, the antenna is from where the ranging beam meets the road, or from the surround sensor."""
    if vehicle.antenna is None:
        return 1.0
    if vehicle.ranging is None:
        arm = None if vehicle.lidar is None else vehicle.antenna.minus(vehicle.lidar)
        return 1.0 if arm is None else math.hypot(arm.x_m, arm.y_m)
    arm = vehicle.antenna.minus(vehicle.ranging.sensor)
    return math.hypot(arm.x_m, arm.y_m) + 0.5 * vehicle.ranging.sensor.z_m
