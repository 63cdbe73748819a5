"""Registers a made-up local map to a made-up map by point-to-plane ICP and prints the estimated shift and yaw.

    python examples/register_clouds.py --east-m 0.6 --north-m -0.4 --yaw-deg 3

Both clouds sample the walls of a yard at different random points. The local map is displaced by the shift and yaw of
the command line, which the registration does not know. Its first guess is no displacement at all.
"""

import argparse
import math
import sys

import numpy as np

from camber.geodesy.se3 import invert, map_from_vehicle, roll_pitch_yaw_from_rotation, transform_points
from camber.localizer.arrays import Floats
from camber.localizer.map_clouds.voxel_grid import voxel_means
from camber.localizer.matching.icp import IcpOptions, icp_point_to_plane
from camber.localizer.matching.registration import LayerTarget

CORNERS_M = np.array([(-20.0, -12.0), (20.0, -12.0), (20.0, 5.0), (8.0, 15.0), (-20.0, 15.0)])


def wall_points(count: int, random: np.random.Generator) -> Floats:
    """Return `count` points (count, 3) [m] on each wall, 3 m high, with a noise of 1 cm."""
    walls = []
    for start, end in zip(CORNERS_M, np.roll(CORNERS_M, -1, axis=0), strict=True):
        along = start + random.random((count, 1)) * (end - start)
        walls.append(np.column_stack((along, random.uniform(0.0, 3.0, count))))
    return np.concatenate(walls) + random.normal(0.0, 0.01, (count * len(walls), 3))


def main() -> int:
    """Print the estimate, or that the registration did not converge; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--east-m", type=float, default=0.6)
    parser.add_argument("--north-m", type=float, default=-0.4)
    parser.add_argument("--yaw-deg", type=float, default=3.0, help="counter-clockwise")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    random = np.random.default_rng(args.seed)
    attitude = {"roll_rad": 0.0, "pitch_rad": 0.0, "yaw_rad": math.radians(args.yaw_deg)}
    truth = map_from_vehicle(args.east_m, args.north_m, 0.0, **attitude)
    target = LayerTarget.of(voxel_means(wall_points(2500, random), 0.2))
    local_m = transform_points(invert(truth), voxel_means(wall_points(1000, random), 0.3))
    options = IcpOptions(free="planar", max_distance_m=3.0, first_scale_m=1.0)
    result = icp_point_to_plane([(target, local_m)], np.eye(4), options)
    if not result.converged:
        print("unknown: not converged")
        return 1
    (east_m, north_m), yaw_rad = result.transform[:2, 3], roll_pitch_yaw_from_rotation(result.transform)[2]
    print(f"east {east_m:+.3f} m, north {north_m:+.3f} m, yaw {math.degrees(yaw_rad):+.3f}°")
    return 0


if __name__ == "__main__":
    sys.exit(main())
