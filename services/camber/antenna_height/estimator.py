"""The antenna height of one vehicle from its inputs: the service without a bus."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from camber.antenna_height.available_heights import VehicleGeometry, heights_at, road_of
from camber.antenna_height.latest_inputs import HeightInputs
from camber.antenna_height.method_comparison import Comparison, ComparisonRules, References
from camber.antenna_height.method_selection import (
    Flatness,
    FlatRules,
    antenna_height_message,
    select_method,
)
from camber.schemas.antenna import AntennaHeight, HeightMethod
from camber.schemas.pose import Pose

_DRIVING_M_S = 1.0  # chosen: above the noise of wheel speeds and Doppler at rest


@dataclass(frozen=True, slots=True, kw_only=True)
class AntennaOptions:
    """`method`: whose height is published."""

    vehicle: VehicleGeometry
    method: HeightMethod | Literal["automatic"] = "fixed"
    comparison: ComparisonRules = field(default_factory=ComparisonRules)
    flat: FlatRules = field(default_factory=FlatRules)


class HeightOutput(NamedTuple):
    """A height, and what an operator should know."""

    height: AntennaHeight
    problems: tuple[str, ...]


class AntennaHeightEstimator:
    """Estimates one vehicle's antenna height. `earlier`: differences of its methods in earlier drives."""

    def __init__(self, options: AntennaOptions, earlier: References | None = None) -> None:
        self._options = options
        self._inputs = HeightInputs()
        self._comparison = Comparison(options.comparison, earlier)
        self._flatness = Flatness(rules=options.flat, reach_m=_reach_m(options.vehicle))
        self._method: HeightMethod | None = None

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Return the handler of each input channel."""
        inputs = self._inputs
        return {
            "motion": inputs.motion.update,
            "suspension": inputs.suspension.update,
            "ranging": inputs.ranging.update,
            "pose": self._on_pose,
            "scan_match": inputs.match.update,
        }

    def _on_pose(self, pose: Pose) -> None:
        self._inputs.pose.update(pose)
        road = road_of(pose, self._options.vehicle.pose_sigma_limit_m)
        self._flatness.update(pose.time_ns, road, pose.speed_m_s)

    @property
    def references(self) -> References:
        """The differences of the methods, for the next drive."""
        return self._comparison.references

    @property
    def source_time_ns(self) -> int:
        """Time of the newest measurement of the published method; zero where it is not measured."""
        method = self._method if self._options.method == "automatic" else self._options.method
        match method:
            case "stroke":
                return self._inputs.suspension.time_ns
            case "ranging" if self._options.vehicle.ranging is not None:
                return self._inputs.ranging.time_ns
            case "ranging" | "scan_matching":
                return self._inputs.match.time_ns
            case _:
                return 0

    def height(self, now_ns: int) -> HeightOutput:
        """Compute the height at a time."""
        heights = heights_at(now_ns, self._options.vehicle, self._inputs)
        speed_m_s = self._inputs.speed_m_s(now_ns)
        driving = speed_m_s is not None and abs(speed_m_s) > _DRIVING_M_S
        self._comparison.test(now_ns, tuple(heights.known.values()), driving=driving)
        selected = select_method(self._options.method, heights, self._flatness)
        self._method = selected[0]
        disagreement = self._comparison.text(now_ns)
        message = antenna_height_message(now_ns, selected, heights, disagreement=disagreement)
        return HeightOutput(message, tuple(heights.problems))


def _reach_m(vehicle: VehicleGeometry) -> float:
    """Return about the level distance of the antenna from where the ranging beam meets the road, or from the LiDAR."""
    sensor = vehicle.lidar if vehicle.ranging is None else vehicle.ranging.sensor
    if vehicle.antenna is None or sensor is None:
        return 1.0
    arm = vehicle.antenna.minus(sensor)
    return math.hypot(arm.x_m, arm.y_m) + (0.0 if vehicle.ranging is None else 0.5 * sensor.z_m)
