"""`camber export RUN --rosbag OUT`: verdicts and positions of a run as a ROS 2 bag (MCAP), without ROS.

RUN is the folder of a replay, or a recording (.mcap). Topics: /camber/fix, /camber/pose, /camber/verdict, /diagnostics.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import StoragePlugin, Writer

from camber.formats.drive.recording import Recorded, RecordingError, read_recording
from camber.formats.errors import FormatError
from camber.formats.ros import judged_messages as judged
from camber.formats.ros.message_types import VERDICT_TYPE, message_types
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.geodesy.local_frame import LocalFrame
from camber.replay.run_folder import RunFolder
from camber.schemas.integrity import Position, Verdict
from camber.tools.options.error_report import report_failures
from camber.tools.options.output_check import check_output_folder
from camber.tools.options.parsers import tool_parser

_PROG = "camber export"
TOPICS = {
    "/camber/fix": judged.FIX_TYPE,
    "/camber/pose": judged.POSE_TYPE,
    "/camber/verdict": VERDICT_TYPE,
    "/diagnostics": judged.DIAGNOSTICS_TYPE,
}


def main(argv: Sequence[str]) -> int:
    """Export one run; 0 done, 2 the run cannot be read or the bag not written, 130 interrupted."""
    parser = tool_parser(_PROG, __doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a replay, or a recording")
    parser.add_argument(
        "--rosbag", type=Path, required=True, metavar="OUT", help="folder of the bag to write"
    )
    args = parser.parse_args(argv)
    return report_failures(_PROG, args.rosbag, lambda: export_bag(args.run, args.rosbag))


def export_bag(run: Path, out: Path) -> str:
    """Write the bag and return what it has. A damaged recording gives what is before the damage.

    Raises FormatError where there is no verdict or position, or something is in the folder, OSError.
    """
    recording = RunFolder(run).recording_path if run.is_dir() else run
    errors: list[RecordingError] = []
    check_output_folder(out)
    items = read_recording(recording, ("verdict", "position"))
    first = next(items, None)
    if first is None or isinstance(first, RecordingError):
        raise first or FormatError(recording.name, "messages", "verdicts or positions")
    with suppress(FileNotFoundError):  # the library takes no folder, not even an empty one
        out.rmdir()
    with Writer(out, version=8, storage_plugin=StoragePlugin.MCAP) as bag:
        topics = _BagTopics(bag, _positions_of_fixes(recording))
        for item in chain([first], items):
            if isinstance(item, RecordingError):
                errors.append(item)
            else:
                topics.add(item)
        if topics.map_frame is not None:
            origin = topics.map_frame
            degrees = math.degrees(origin.latitude_rad), math.degrees(origin.longitude_rad)
            bag.set_custom_data("map_origin", f"{degrees[0]:.9f} {degrees[1]:.9f} {origin.height_m:.4f}")
    lines = [f"{topic}: {topics.counts[topic]} of {kind}" for topic, kind in TOPICS.items()]
    return "\n".join([*lines, *map(str, errors), f"Written: {out}."])


def _positions_of_fixes(recording: Path) -> dict[tuple[int | None, int], Position]:
    """Return the positions that are fixes by the fix and their time: a verdict comes before its position."""
    items = read_recording(recording, ("position",))
    messages = [item.message for item in items if not isinstance(item, RecordingError)]
    return {(message.fix_id, message.time_ns): message for message in messages if message.source == "rtk"}


class _BagTopics:
    """The topics of a bag. The origin of `map` is the first usable position."""

    def __init__(self, bag: Writer, positions: Mapping[tuple[int | None, int], Position]) -> None:
        self._positions = positions
        self.counts: Counter[str] = Counter()
        self.map_frame: LocalFrame | None = None
        self._bag, self._types = bag, message_types()
        self._connections = {
            topic: bag.add_connection(topic, kind, typestore=self._types) for topic, kind in TOPICS.items()
        }

    def add(self, item: Recorded[Any]) -> None:
        """Write the messages of a verdict or a position."""
        message: Verdict | Position = item.message
        if isinstance(message, Verdict):
            self._write("/camber/verdict", message.time_ns, judged.verdict_message(message))
            if message.fix_id is not None:
                position = self._positions.get((message.fix_id, message.time_ns))
                trusted = position is not None and judged.is_trusted(message, position)
                fix = judged.fix_message(message) if trusted else judged.no_fix_message(message.time_ns)
                self._write("/camber/fix", message.time_ns, fix)
            return
        place = judged.usable_place(message)
        if place is not None:
            self.map_frame = self.map_frame or LocalFrame(*place)
            self._write("/camber/pose", message.time_ns, judged.pose_message(message, place, self.map_frame))
        self._write("/diagnostics", message.time_ns, judged.diagnostics_message(message, item.key))

    def _write(self, topic: str, time_ns: int, message: Any) -> None:
        data = self._types.serialize_cdr(message, TOPICS[topic])
        self._bag.write(self._connections[topic], unix_ns_from_gps_ns(time_ns), data)
        self.counts[topic] += 1
