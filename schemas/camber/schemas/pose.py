"""Where the vehicle is without the satellites under test, and the road under its antenna."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from camber.schemas.base import (
    Angle,
    ArrayOf,
    Count,
    Covariance2,
    Covariance3,
    Float32,
    Float64,
    Height,
    Int32,
    Int64,
    Latitude,
    Longitude,
    Message,
    Model,
    Name,
    Probability,
    Sigma,
    Speed,
    Text,
    TimeNs,
    UInt8,
    Vector3,
)

RoadStatus = Literal["known", "unknown"]
RoadReason = Literal[
    "none",
    "no_pose",
    "pose_too_uncertain",
    "no_surface",
    "levels_ambiguous",
    "map_stale",
    "map_missing",
    "map_server_absent",
    "datum_mismatch",
]
PoseMode = Literal["none", "provisional", "anchored", "dead_reckoning", "scan_match"]
Provenance = Literal["none", "fixes", "given", "confirmed", "scan_match"]
HorizontalBasis = Literal["none", "scan_match", "given", "relief", "odometry", "fixes"]
"""What a horizontal position rests on. Only `scan_match`, `given` and `relief` have no part of a satellite position;
`odometry`: of one of these, longer ago than it counts as fresh."""
IndependentBasis = Literal["scan_match", "given", "relief"]
Offset2 = tuple[Annotated[float, Field(ge=-1e4, le=1e4)], Annotated[float, Field(ge=-1e4, le=1e4)]]
"""East, north."""


class RoadPatch(Model):
    """The road around the antenna's approximate position, sampled: for a pose that may be metres off.

    Row i is the plane at an offset (east, north) in metres from the pose's antenna. All are surfaces the vehicle can be
    on by links and levels; none was chosen by a height. A sample speaks for `reach_m` around it.
    """

    reach_m: Sigma
    surface_id: Annotated[Int64, ArrayOf("<i8", ("samples",))]
    east_m: Annotated[Float64, ArrayOf("<f8", ("samples",))]
    north_m: Annotated[Float64, ArrayOf("<f8", ("samples",))]
    elevation_m: Annotated[Float64, ArrayOf("<f8", ("samples",))]
    sigma_m: Annotated[Float64, ArrayOf("<f8", ("samples",), ge=0.0)]
    slope_east: Annotated[Float64, ArrayOf("<f8", ("samples",))]
    slope_north: Annotated[Float64, ArrayOf("<f8", ("samples",))]


class Road(Model):
    """The road under the antenna: a plane about the antenna's approximate position, or why there is none.

    The elevation at an offset (east, north) in metres from the pose's antenna position is
    `elevation_m + slope_east · east + slope_north · north`, good within `extent_m`.
    """

    status: RoadStatus
    reason: RoadReason = "none"
    surface_id: Count | None = None
    level: Annotated[int, Field(ge=-20, le=20)] | None = None
    elevation_m: Height | None = Field(None, description="ellipsoidal height of the road surface")
    sigma_m: Sigma | None = Field(None, description="of the map's elevation itself, without the pose's share")
    slope_east: Annotated[float, Field(ge=-2.0, le=2.0)] | None = None
    slope_north: Annotated[float, Field(ge=-2.0, le=2.0)] | None = None
    extent_m: Sigma | None = None
    datum: Name | None = None
    map_version: Count | None = None
    patch: RoadPatch | None = Field(
        None, description="the road around, where it was asked for and the pose is uncertain"
    )


class IndependentPosition(Model):
    """Where the antenna is by evidence in which no horizontal satellite position had a part.

    Scan matches, a given pose and the road's relief (heights of fixes against heights of the map), carried by odometry
    and coupled to the map's links. No verdict and no fix's east or north changes it.
    """

    basis: IndependentBasis = Field(description="the last evidence")
    latitude_rad: Latitude = Field(description="of the antenna, at the pose's time")
    longitude_rad: Longitude = Field(description="of the antenna, at the pose's time")
    covariance_east_north: Covariance2 = Field(description="(ee, en, nn) in m²")
    evidence_time_ns: TimeNs = Field(description="of the last evidence")
    distance_m: Sigma = Field(description="driven since the last evidence")


class FixesOffset(Model):
    """How far fixes are off the map by their heights alone, over the way that they have shown: fix less true place.

    Their own east and north are the shape of the track, which the road's relief below it shifts: neither odometry nor
    the pose has a part in it, but which road is driven.
    """

    begin_time_ns: TimeNs = Field(description="of the window")
    end_time_ns: TimeNs = Field(description="of the window")
    east_north_m: Offset2 = Field(description="on average over the window")
    covariance_east_north: Covariance2 = Field(description="(ee, en, nn) in m²")
    growth_east_north_m_s: Offset2 = Field(description="of the offset within the window")
    growth_covariance_east_north: Covariance2 = Field(description="(ee, en, nn) in m²/s²")
    steps: Count = Field(
        0,
        description="of the fixes since the window, by which the offset was moved; above 0 it is no estimate anew",
    )


class Pose(Message):
    """Approximate pose of the vehicle and of its antenna, owing nothing to unconfirmed satellite positions."""

    mode: PoseMode
    provenance: Provenance
    reason: Text = Field("", description="why there is no pose, or why it is only provisional")
    latitude_rad: Latitude | None = Field(None, description="of the antenna")
    longitude_rad: Longitude | None = Field(None, description="of the antenna")
    yaw_rad: Angle | None = Field(None, description="counter-clockwise from east, of the vehicle's x")
    covariance_east_north_yaw: Covariance3 | None = Field(
        None, description="(ee, en, eψ, nn, nψ, ψψ) in m², m·rad, rad², of antenna position and yaw"
    )
    pitch_rad: Angle | None = None
    roll_rad: Angle | None = None
    speed_m_s: Speed | None = None
    yaw_rate_rad_s: Annotated[float, Field(ge=-20.0, le=20.0)] | None = None
    link_id: Count | None = None
    anchor_time_ns: TimeNs | None = Field(None, description="of the last confirmed position that entered")
    motion_time_ns: TimeNs | None = Field(None, description="of the last motion sample that entered")
    match_time_ns: TimeNs | None = Field(
        None, description="of the last scan match that entered and left no direction open"
    )
    horizontal_basis: HorizontalBasis = Field(
        "none", description="what the pose's own horizontal position rests on"
    )
    independent: IndependentPosition | None = Field(
        None, description="the position without any satellite's horizontal position, where there is one"
    )
    road: Road
    fixes_offset: FixesOffset | None = Field(
        None, description="offset of the fixes by heights over their own track, where heights determine it"
    )
    fix_run_begin_time_ns: TimeNs | None = Field(
        None,
        description="since when each fix continues the one before, within 1 s: other integers would have been a step",
    )


class ScanMatch(Message):
    """A layered scan match of one local map against the environment map.

    Two heights of the sensor above the road, both along the vertical: `sensor_height_m` owes to the match and the map's
    road, `ground_height_m` to the sweep's own returns from the road near the vehicle, without any map. Slopes are
    metres of height a metre along the heading's axes, level: forward, and to its left.
    """

    status: Literal["converged", "ambiguous", "lost"]
    reason: Text = ""
    latitude_rad: Latitude | None = None
    longitude_rad: Longitude | None = None
    height_m: Height | None = Field(None, description="ellipsoidal, of the sensor")
    sensor_height_m: Annotated[float, Field(ge=-10.0, le=100.0)] | None = Field(
        None,
        description="vertical distance from the map's road surface below the sensor to the sensor, from matching",
    )
    sensor_height_sigma_m: Sigma | None = None
    ground_height_m: Annotated[float, Field(ge=-10.0, le=100.0)] | None = Field(
        None,
        description="the same by the sensor's own returns from the road near the vehicle, without the map",
    )
    ground_height_sigma_m: Sigma | None = None
    road_slope_forward: Annotated[float, Field(ge=-2.0, le=2.0)] | None = Field(
        None, description="of the map's road under the vehicle, along the heading, up positive"
    )
    road_slope_left: Annotated[float, Field(ge=-2.0, le=2.0)] | None = Field(
        None, description="of the same across it, up to the left positive"
    )
    roll_pitch_yaw_rad: Vector3 | None = Field(
        None, description="of the vehicle, against the vertical and east"
    )
    covariance_east_north: Covariance2 | None = None
    overlap: Probability | None = None
    layer: Annotated[Int32, ArrayOf("<i4", ("layers",), ge=0)] | None = Field(
        None, description="numbers of the layers that had partners in the map, 0 the lowest; None: all"
    )
    layer_mean_distance_m: Annotated[Float64, ArrayOf("<f8", ("layers",), ge=0.0)] | None = None

    def distances_m(self, layers: int) -> Float64:
        """Mean distance of each of so many layers (layers,), NaN for those without partners."""
        distances = np.full(layers, np.nan)
        if self.layer_mean_distance_m is not None:
            numbers = np.arange(len(self.layer_mean_distance_m)) if self.layer is None else self.layer
            seen = numbers < layers
            distances[numbers[seen]] = self.layer_mean_distance_m[seen]
        return distances

    @property
    def layers(self) -> int:
        """How many layers there are at least."""
        if self.layer is not None:
            return int(self.layer.max(initial=-1)) + 1
        return 0 if self.layer_mean_distance_m is None else len(self.layer_mean_distance_m)


class ScanMatchPoints(Message):
    """Points of one scan match where it has placed them, and their distance from the map; thinned, for viewers.

    East and north are from the place of the vehicle's origin in the match. `status` is that of the registration,
    before the match was compared with the pose.
    """

    status: Literal["converged", "ambiguous"]
    latitude_rad: Latitude
    longitude_rad: Longitude
    east_m: Annotated[Float32, ArrayOf("<f4", ("points",), ge=-1000.0, le=1000.0)]
    north_m: Annotated[Float32, ArrayOf("<f4", ("points",), ge=-1000.0, le=1000.0)]
    paired: Annotated[UInt8, ArrayOf("|u1", ("points",), le=1)] = Field(
        description="1: has a partner in the map; 0: `residual_m` is not known"
    )
    residual_m: Annotated[Float32, ArrayOf("<f4", ("points",))] = Field(
        description="from the plane of the map's nearest points, positive beyond it as seen from the vehicle"
    )
