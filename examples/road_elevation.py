"""Prints elevation, slope and σ of the road at a point, from a map release on this machine, without a bus.

    camber demo --short
    python examples/road_elevation.py out/demo/drive/map 35 137

Latitude and longitude are in degrees. The program prints *unknown* with the reason where the release has no road, or
where several decks make the elevation ambiguous. A damaged release ends the program with exit code 2 and one line on
standard error.
"""

import argparse
import math
import sys
from pathlib import Path

import camber
from camber.road_map.release import ReleaseError
from camber.tools.options.number_options import LATITUDE, LONGITUDE

PROG = "road_elevation.py"


def main() -> int:
    """Print one line; return the exit code."""
    parser = argparse.ArgumentParser(
        prog=PROG, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("release", type=Path, help="folder of a map release")
    parser.add_argument("latitude", type=LATITUDE, help="degrees")
    parser.add_argument("longitude", type=LONGITUDE, help="degrees")
    args = parser.parse_args()
    try:
        road_map = camber.Map(args.release)
        roads = road_map.elevations(math.radians(args.latitude), math.radians(args.longitude))
    except ReleaseError as error:
        print(f"{PROG}: {error}", file=sys.stderr)
        return 2
    road = {name: column[0] for name, column in roads.items()}
    if road["reason"] != "none":
        print(f"unknown ({road['reason']})")
    else:
        print(f"elevation {road['elevation_m']:.3f} m ({road_map.datum}), sigma {road['sigma_m']:.3f} m")
        print(f"slope {road['slope_east']:+.2%} to the east, {road['slope_north']:+.2%} to the north")
    return 0


if __name__ == "__main__":
    sys.exit(main())
