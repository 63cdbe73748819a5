"""`camber import BAG --out DRIVE`: make a drive folder of a ROS bag, without ROS.

BAG is a ROS 2 bag (folder, .mcap or .db3) or ROS 1 bags that were recorded together. DRIVE/drive.toml says what was
there, and in comments what is guessed, missing and not taken. `camber replay DRIVE/drive.toml` runs it.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from camber.formats.errors import FormatError
from camber.formats.ros.bag_reader import open_bag
from camber.schemas.drive import load_manifest
from camber.tools.bags.drive_import import DriveParts, TopicTally, static_frames, write_drive_files
from camber.tools.bags.imported_manifest import imported_manifest
from camber.tools.bags.raw_bytes import RawBytes
from camber.tools.bags.topic_choice import TopicNames, choose_topics
from camber.tools.options.error_report import report_failures
from camber.tools.options.output_check import check_output_folder
from camber.tools.options.parsers import tool_parser
from camber.tools.options.progress_display import ProgressDisplay

_PROG = "camber import"
_BASE_FRAMES = ("base_footprint", "base_link")  # REP 120, REP 105


def main(argv: Sequence[str]) -> int:
    """Import one recording; 0 done, 2 the bag cannot be used, 130 interrupted."""
    args = _parser().parse_args(argv)
    names = TopicNames(lidar=args.lidar, receiver=args.receiver, odometry=args.odometry, imu=args.imu)

    def work() -> str:
        return import_bag(args.bag, args.out, names, base_frame=args.base_frame)

    return report_failures(_PROG, args.out, work)


def import_bag(paths: Sequence[Path], out: Path, names: TopicNames, *, base_frame: str | None = None) -> str:
    """Write the drive and return what it has; the folder appears whole or not at all.

    Raises FormatError, ManifestError, OSError.
    """
    check_output_folder(out)
    bag_name = paths[0].resolve().name
    out.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".camber-import-", dir=out.parent) as temporary, open_bag(paths) as bag:
        folder = Path(temporary) / "drive"
        folder.mkdir()
        topics, frames = choose_topics(bag.topics, names, bag_name), static_frames(bag)
        default = next((frame for frame in _BASE_FRAMES if frame in frames), _BASE_FRAMES[-1])
        if base_frame is not None and frames.names and base_frame not in frames:
            expected = f"one of /tf_static: {', '.join(sorted(frames.names))}"
            raise FormatError("--base-frame", "frame", expected, actual=base_frame)
        parts = DriveParts(
            topics=topics,
            tallies={name: TopicTally(topic=bag.topics[name]) for name in topics.names},
            raw=RawBytes(folder),
            frames=frames,
            base_frame=base_frame or default,
        )
        messages = sum(bag.topics[name].messages for name in topics.names)
        with ProgressDisplay(messages, "message") as display:
            write_drive_files(bag, parts, folder, progress=display.advance)
        name = re.sub(r"[^A-Za-z0-9_.:@+-]", "-", Path(bag_name).stem).lstrip("_.:@+-")[:64] or "bag"
        text = imported_manifest(name, [path.resolve().name for path in paths], parts)
        (folder / "drive.toml").write_text(text, "utf-8")
        load_manifest(folder / "drive.toml")
        folder.rename(out)
    notes = [line.removeprefix("# ") for line in text.splitlines() if line.startswith(_PRINTED)]
    return "\n".join([*notes, f"Written: {out / 'drive.toml'}."])


_PRINTED = ("# /", "# left out", "# wrong", "# missing", "# not taken")
"""Comments of the manifest that are printed, too."""


def _parser() -> argparse.ArgumentParser:
    parser = tool_parser(_PROG, __doc__)
    add = parser.add_argument
    add("bag", type=Path, nargs="+", metavar="BAG", help="the bag")
    add("--out", type=Path, required=True, metavar="DRIVE", help="folder to write")
    add("--lidar", metavar="TOPIC", help="PointCloud2 or Livox CustomMsg to take, where there are several")
    add("--receiver", metavar="TOPIC", help="NavSatFix or GPSFix to take")
    add("--odometry", metavar="TOPIC", help="Odometry, TwistStamped or TwistWithCovarianceStamped to take")
    add("--imu", metavar="TOPIC", help="Imu to take")
    add("--base-frame", metavar="FRAME", help="the vehicle's frame (default base_footprint, else base_link)")
    return parser
