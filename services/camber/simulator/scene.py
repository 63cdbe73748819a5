"""What a simulated place is made of, and the paths through it: the types that world, vehicle and satellites share.

**World frame.** (east, north) in metres are those of the tangent plane at height zero about the district's origin, as
`LocalFrame(latitude, longitude, 0.0).east_north_from_geodetic` gives them; the third coordinate, up, is the
*ellipsoidal height*. Within a district of two kilometres it is used as a Cartesian frame: at 1 km from the origin
its vertical is 0.16 mrad off the true one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]


class Material(IntEnum):
    """What a surface is of."""

    ROAD = 0
    GROUND = 1
    BUILDING = 2
    POLE = 3
    TREE = 4
    VEHICLE = 5
    TUNNEL = 6


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Shapes:
    """Solids and surfaces, as columns, in the world frame.

    `boxes_m` (n, 7): east, north of the centre, up of the base, half length along yaw, half width across, height, yaw
    (radians, counter-clockwise from east). `cylinders_m` (n, 5): east, north, up of the base, radius, height; upright.
    `crowns_m` (n, 5): east, north, up of the centre, horizontal and vertical radius: ellipsoids, the crowns of trees.
    `triangles_m` (n, 3, 3): corners; both sides are seen. Each has its `*_material` (n,), values of `Material`.
    """

    boxes_m: Floats
    boxes_material: Integers
    cylinders_m: Floats
    cylinders_material: Integers
    crowns_m: Floats
    triangles_m: Floats
    triangles_material: Integers

    @classmethod
    def of(
        cls,
        *,
        boxes: Sequence[Sequence[float]] = (),
        cylinders: Sequence[Sequence[float]] = (),
        crowns: Sequence[Sequence[float]] = (),
        triangles: Floats | Sequence[Floats] = (),
    ) -> Shapes:
        """From rows: boxes are buildings, cylinders poles, triangles road."""
        return cls(
            boxes_m=np.array(boxes, np.float64).reshape(-1, 7),
            boxes_material=np.full(len(boxes), int(Material.BUILDING)),
            cylinders_m=np.array(cylinders, np.float64).reshape(-1, 5),
            cylinders_material=np.full(len(cylinders), int(Material.POLE)),
            crowns_m=np.array(crowns, np.float64).reshape(-1, 5),
            triangles_m=np.array(triangles, np.float64).reshape(-1, 3, 3),
            triangles_material=np.full(len(triangles), int(Material.ROAD)),
        )


class Hits(NamedTuple):
    """What n rays met first, or nothing.

    `distance_m` (n,), infinite where nothing; `material` (n,), −1 where nothing; `normal` (n, 3), the unit normal of
    the surface towards the ray's origin, zero where nothing.
    """

    distance_m: Floats
    material: Integers
    normal: Floats


class Walls(NamedTuple):
    """Upright rectangles that reflect satellites' signals.

    `foot_m` (n, 3) one lower corner, `along` (n, 2) unit vector to the other one, `length_m`, `height_m` (n,),
    `normal` (n, 2) unit vector outwards.
    """

    foot_m: Floats
    along: Floats
    length_m: Floats
    height_m: Floats
    normal: Floats


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Path:
    """The path of a vehicle's rear axle over the road: samples every `step_m` of it, columns (n,).

    `yaw_rad` is unwrapped, counter-clockwise from east. `grade` is dz/ds along, `crossfall` dz/dy towards the left.
    `link_offset_m` is the distance from the link's true centre line, positive to the left. `speed_limit_m_s` is the
    speed that traffic allows there; zero: the vehicle stops, for `stop_s`.
    """

    step_m: float
    east_m: Floats
    north_m: Floats
    up_m: Floats
    yaw_rad: Floats
    grade: Floats
    crossfall: Floats
    level: Integers
    link_id: Integers
    link_offset_m: Floats
    speed_limit_m_s: Floats
    stop_s: Floats
    tunnel: Booleans
    surface_m: Callable[[Floats, Floats, Integers], Floats]
    """(east, north, level) → height of the road's surface there (ellipsoidal); NaN off any road of that level."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Trajectory:
    """True motion of a vehicle, columns (n,) or (n, 3) in the world frame, at even steps of time.

    The vehicle's origin is on the road below the middle of its rear axle; x forward, y left, z up. `roll_rad`,
    `pitch_rad`, `yaw_rad`: R = Rz(yaw) Ry(pitch) Rx(roll), pitch positive with the nose down, of the *body*: road and
    suspension.
    `wheel_speed_m_s` is the true speed of the wheels' circumference at the nominal radius.
    """

    time_ns: Integers
    origin_m: Floats
    roll_rad: Floats
    pitch_rad: Floats
    yaw_rad: Floats
    velocity_m_s: Floats
    speed_m_s: Floats
    wheel_speed_m_s: Floats
    yaw_rate_rad_s: Floats
    steering_rad: Floats
    stroke_m: Floats
    antenna_m: Floats
    antenna_velocity_m_s: Floats
    antenna_height_m: Floats
    road_height_m: Floats
    level: Integers
    link_id: Integers
    link_offset_m: Floats
