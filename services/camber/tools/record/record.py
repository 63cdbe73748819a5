"""`camber record`: record the messages on a vehicle's bus into MCAP files that other programs read.

SIGTERM or SIGINT ends the recording and closes the file. After a kill or a power cut a file can be read up to its last
complete chunk (256 kB, or 10 s).
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from camber.road_map.release import open_release
from camber.road_map.road_columns import ReleaseError
from camber.road_map.road_drawing import draw_roads
from camber.runtime.raw_subscription import RawSubscription
from camber.runtime.session import BusError
from camber.schemas.channels import BY_NAME, CHANNELS, Channel
from camber.tools.options.bus_options import add_bus_options, bus_settings
from camber.tools.options.number_options import SECONDS, number_from
from camber.tools.options.parsers import add_with_default, tool_parser
from camber.tools.options.stop_signals import stopped_by_signals
from camber.tools.record.recording_files import RecordingFiles, RecordingLimits

_PROG = "camber record"
_WRITE_EVERY_S = 0.2  # chosen: few wake-ups; at most this much more is in memory than on the way to the disk
_MB = 1 << 20  # bytes of a MiB
RECORDABLE = tuple(c for c in CHANNELS if c.delivery in ("small", "bulk"))
_HELP = """\
exit codes: 0 stopped by a signal or --duration; 1 writing failed (files so far are readable); 2 wrong usage; 3 no bus.
While it waits for the bus a signal ends it at once.
"""


def main(argv: Sequence[str]) -> int:
    """Record until a signal or the end of --duration."""
    args = _parser().parse_args(argv)
    try:
        channels = chosen(args.channels, args.without, sweeps=args.sweeps)
        if args.keep_mb is not None and args.keep_mb < 2.0 * args.max_mb:
            # One file is being written, and deleting must leave at least one complete file before it.
            least_mb = 2.0 * args.max_mb
            raise ValueError(f"--keep-mb {args.keep_mb:g}: expected at least {least_mb:g}, twice --max-mb")
    except ValueError as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 2
    settings = bus_settings(args, prog=_PROG, vehicle=args.vehicle)
    limits = RecordingLimits(
        file_bytes=round(args.max_mb * _MB),
        file_s=None if args.max_minutes is None else 60.0 * args.max_minutes,
        kept_bytes=None if args.keep_mb is None else round(args.keep_mb * _MB),
        free_bytes=round(args.leave_mb * _MB),
    )
    try:
        roads = None if args.map is None else draw_roads(open_release(args.map).road_links())
        files = RecordingFiles(args.out, settings.vehicle, limits, roads=roads)
    except ReleaseError as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{_PROG}: --out {args.out}: {error.strerror or error}", file=sys.stderr)
        return 2
    # No file is open yet, and Python's signal handlers do not run while Zenoh waits for a router.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        with RawSubscription(settings, channels, timeout_s=args.timeout) as tap, stopped_by_signals() as stop:
            names = ", ".join(channel.name for channel in channels)
            print(f"{_PROG}: {settings.vehicle}: {names}, into {args.out}", file=sys.stderr, flush=True)
            end_s = time.monotonic() + (float("inf") if args.duration is None else args.duration)
            reported: Counter[str] = Counter()
            while not stop.wait(_WRITE_EVERY_S) and time.monotonic() < end_s and files.problem is None:
                reported = _write(tap, files, reported)
            tap.close()
            _write(tap, files, reported)
            files.close()
    except BusError as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 3
    except OSError as error:
        print(f"{_PROG}: {args.out}: {error.strerror or error}", file=sys.stderr)
        return 1
    print(summary(files), flush=True)
    if files.problem is not None:
        print(f"{_PROG}: {files.problem}", file=sys.stderr)
    return 0 if files.problem is None else 1


def chosen(names: str | None, without: str | None, *, sweeps: bool) -> tuple[Channel, ...]:
    """Return the channels to record; sweeps only where named, or with `sweeps`. Raises ValueError."""
    every = [channel.name for channel in RECORDABLE if channel.delivery != "bulk" or sweeps]
    wanted = set(every if names is None else names.split(","))
    left_out = set() if without is None else set(without.split(","))
    known = {channel.name for channel in RECORDABLE}
    for name in sorted((wanted | left_out) - known):
        is_query, others = "a query channel, which is not recorded", f"not one of {', '.join(sorted(known))}"
        raise ValueError(f"channel {name!r}: {is_query if name in BY_NAME else others}")
    wanted |= {"sweep"} if sweeps else set()
    channels = tuple(c for c in RECORDABLE if c.name in wanted - left_out)
    if not channels:
        raise ValueError("no channel is left")
    return channels


def summary(files: RecordingFiles) -> str:
    """Return one line with counts of written, dropped and malformed messages."""
    counts = ", ".join(f"{name} {count}" for name, count in sorted(files.by_channel.items()))
    size = sum(path.stat().st_size for path in files.files if path.exists())
    return (
        f"{files.written} messages in {len(files.files)} files, {size / 1e6:.1f} MB ({counts or 'none received'}); "
        f"{files.dropped} dropped, {files.malformed} malformed"
    )


def _write(tap: RawSubscription, files: RecordingFiles, reported: Counter[str]) -> Counter[str]:
    """Write the messages received; report those dropped because the disk is slower than the bus."""
    items, dropped = tap.take(), Counter(tap.dropped)
    files.write(items, time.monotonic(), lost=dropped.total() - reported.total())
    if dropped != reported:
        counts = ", ".join(f"{name} {count}" for name, count in sorted(dropped.items()))
        text = f"{_PROG}: the disk is slower than the bus, dropped so far: {counts}"
        print(text, file=sys.stderr, flush=True)
    return dropped


def _parser() -> argparse.ArgumentParser:
    parser = tool_parser(_PROG, __doc__, _HELP)
    add, above_0, mb = parser.add_argument, number_from(0.001, 1e8), number_from(1.0, 1e8)
    add("--out", type=Path, required=True, metavar="FOLDER", help="folder for the files")
    add("--channels", metavar="A,B", help="record only these (default: all but sweeps)")
    add("--without", metavar="A,B", help="omit these channels")
    add("--sweeps", action="store_true", help="record sweeps too, about 1 MB each")
    add("--map", type=Path, metavar="DIR", help="release of the map, whose roads each file then shows")
    add("--duration", type=above_0, metavar="S", help="stop after S seconds")
    add_with_default(parser, "--max-mb", 1024.0, "maximum size of a file", type=mb, metavar="MB")
    add("--max-minutes", type=above_0, metavar="MIN", help="maximum duration of a file")
    text = "maximum size of all files of this vehicle: the oldest are deleted; at least twice --max-mb"
    add("--keep-mb", type=mb, metavar="MB", help=text)
    free_mb = number_from(0.0, 1e8)
    add_with_default(parser, "--leave-mb", 500.0, "free disk space to leave", type=free_mb, metavar="MB")
    add("--vehicle", metavar="V", help="name of the vehicle (default vehicle)")
    add_bus_options(parser)
    add("--timeout", type=SECONDS, metavar="S", help="timeout for joining the bus (default: wait)")
    return parser
