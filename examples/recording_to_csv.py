"""Prints one topic of a recording as CSV, by the `mcap` library and JSON alone: it does not import Camber.

    camber replay path/to/drive.toml --out out/drive
    python examples/recording_to_csv.py out/drive/recording.mcap /integrity/verdict verdict height_difference_m

The first column is UTC. A field that is not known is empty; a dot leads into a nested one: `road.elevation_m`.
"""

import argparse
import csv
import json
import sys
from datetime import UTC, datetime
from typing import Any

from mcap.reader import make_reader


def field_of(message: Any, path: str) -> Any:
    """Return a field of a message, or an empty text where it is not known."""
    for name in path.split("."):
        message = message.get(name, "") if isinstance(message, dict) else ""
    return message


def main() -> int:
    """Print a header and one line for each message; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", help="recording.mcap of a replay, or a file of camber record")
    parser.add_argument("topic", help="a topic whose messages are JSON, such as /gnss/fix")
    parser.add_argument("fields", nargs="+", help="names of fields, as in the message's schema")
    args = parser.parse_args()
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(["utc", *args.fields])
    with open(args.recording, "rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=[args.topic]):
            fields = json.loads(message.data)
            utc = datetime.fromtimestamp(message.log_time / 1e9, UTC)
            table.writerow(
                [utc.isoformat(timespec="milliseconds"), *(field_of(fields, f) for f in args.fields)]
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
