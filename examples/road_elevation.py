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

from camber.map_server.release_queries import ReleaseQueries
from camber.road_map.release import ReleaseError, open_release
from camber.schemas.pose import Road
from camber.schemas.road import ElevationRequest
from camber.tools.options.number_options import LATITUDE, LONGITUDE

PROG = "road_elevation.py"


def road_at(folder: Path, latitude_deg: float, longitude_deg: float) -> Road:
    """Return the road of the release in a folder; raises ReleaseError where the release is damaged or missing."""
    release = open_release(folder)
    time_ns = release.manifest.time_ns  # an age check is the task of the map_server service
    request = ElevationRequest(
        time_ns=time_ns, latitude_rad=math.radians(latitude_deg), longitude_rad=math.radians(longitude_deg)
    )
    return ReleaseQueries(release).elevation(request, time_ns=time_ns).road


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
        road = road_at(args.release, args.latitude, args.longitude)
    except ReleaseError as error:
        print(f"{PROG}: {error}", file=sys.stderr)
        return 2
    if road.status == "unknown":
        print(f"unknown ({road.reason})")
    else:
        print(f"elevation {road.elevation_m:.3f} m ({road.datum}), sigma {road.sigma_m:.3f} m")
        print(f"slope {road.slope_east:+.2%} to the east, {road.slope_north:+.2%} to the north")
    return 0


if __name__ == "__main__":
    sys.exit(main())
