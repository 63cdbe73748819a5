"""Prints where the vehicle is, and *unknown* where nobody can say.

    python examples/consumer.py --vehicle car --connect tcp/127.0.0.1:7447

Unknown means: drive as without satellites. It is unknown until a position comes, when the position says so (`usable` is
false, and `reason` says why), and also when none comes any more: one older than the table's age limit says nothing
about now.
"""

import argparse
import contextlib
import json
import math

import camber
from camber.runtime.session import BusError
from camber.runtime.settings import ServiceSettings, load_or_exit
from camber.schemas.integrity import Position

PROG = "consumer.py"


def line(position: Position) -> str:
    """One position for people; coordinates only where they may be used."""
    if not position.usable or position.latitude_rad is None or position.longitude_rad is None:
        return f"unknown ({position.reason})"
    latitude, longitude = math.degrees(position.latitude_rad), math.degrees(position.longitude_rad)
    level_m = position.horizontal_protection_level_m  # what is usable has one
    assumed = ", if base and signals are honest" if position.horizontal_reference == "assumed" else ""
    return f"{latitude:.8f} {longitude:.8f} within {level_m:.2f} m by {position.source}{assumed}"


def main() -> None:
    """Listen for ever."""
    parser = argparse.ArgumentParser(
        prog=PROG, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--vehicle", default="vehicle")
    parser.add_argument(
        "--connect", action="append", metavar="ENDPOINT", help="router, or any process of the vehicle"
    )
    parser.add_argument(
        "--replay", action="store_true", help="times are those of a drive, not of this machine"
    )
    args = parser.parse_args()
    words = [] if args.connect is None else ["--zenoh.connect", json.dumps(args.connect)]
    settings = load_or_exit(ServiceSettings, ["--vehicle", args.vehicle, *words], prog=PROG)
    print("unknown (no position yet)", flush=True)
    vehicle = camber.connect(settings.vehicle, zenoh=settings.zenoh, replay=args.replay)
    try:
        positions = vehicle.positions()
    except BusError as error:
        raise SystemExit(f"{PROG}: {error}") from None
    with positions:
        for position in positions:
            if position is None:
                print("unknown (nothing new: the last position is too old)", flush=True)
            else:
                print(line(position), flush=True)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
