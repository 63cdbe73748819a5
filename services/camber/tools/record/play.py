"""`camber play`: publish a recording on a bus, with times shifted to now or as recorded.

By default all times in the messages are shifted to the present, so that live services and consumers, which refuse stale
messages, accept them. Bytes of a receiver contain times that cannot be shifted: they are omitted. With
`--times recorded` nothing is changed, at any speed; only consumers that do not check ages accept that
(`Subscription(…, live=False)`, `camber record`). To run services over a drive at another speed use `camber replay`.

It declares liveliness for each producer that it plays, and refuses to start where one of them is already on the bus.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

from camber.formats.drive.recording import Recorded, RecordingError, read_recording
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.query import QueryClient
from camber.runtime.raw_subscription import RawSubscription
from camber.runtime.session import BusError, open_session
from camber.runtime.settings import ServiceSettings
from camber.schemas.channels import BY_NAME, ROS2, SENSORS, Channel
from camber.tools.options.bus_options import add_bus_options, bus_settings
from camber.tools.options.number_options import SECONDS, number_from
from camber.tools.options.parsers import add_with_default, tool_parser
from camber.tools.options.stop_signals import stopped_by_signals
from camber.tools.record.time_shift import NS_PER_FIX_ID, moved

_PROG = "camber play"
_LISTEN_S = 1.0  # chosen: several periods of motion and sweeps
_LATE_S = 0.5  # chosen: consumers would refuse later messages as stale (table of channels)
_LONG_GAP_S = 10.0  # chosen: after a longer silence a user would think that play hangs
_RECORDED = tuple(c for c in BY_NAME.values() if c.delivery in ("small", "bulk"))
PLAYABLE = tuple(c for c in _RECORDED if c.key.startswith("camber/v1/{vehicle}/"))
_RECEIVED_ONLY = tuple(c for c in _RECORDED if c not in PLAYABLE)
"""Channels that a vehicle receives and none of its services publishes."""
_HELP = """\
exit codes: 0 played, or stopped by a signal; 1 a producer is already on the bus, or the recording is damaged (messages
before the damage were played); 2 wrong usage, no such file, or nothing to play; 3 no bus.
"""


class PlaybackError(RuntimeError):
    """This recording cannot be played on this bus; one line."""


def main(argv: Sequence[str]) -> int:
    """Play files one after the other."""
    parser = tool_parser(_PROG, __doc__, _HELP)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="MCAP files, in order")
    add_with_default(
        parser, "--times", "now", "shift times to now, or keep them", choices=("now", "recorded")
    )
    speed, text = number_from(0.001, 1000.0), "playback speed, with --times recorded only"
    add_with_default(parser, "--speed", 1.0, text, type=speed, metavar="F")
    parser.add_argument("--channels", metavar="A,B", help="only these (default: all that were recorded)")
    parser.add_argument("--without", metavar="A,B", help="omit these channels")
    parser.add_argument("--vehicle", metavar="V", help="name of the vehicle (default: the recorded one)")
    add_bus_options(parser)
    add_with_default(parser, "--timeout", 5.0, "timeout for joining the bus", type=SECONDS, metavar="S")
    args = parser.parse_args(argv)
    try:
        if args.speed != 1.0 and args.times == "now":
            raise PlaybackError(
                f"--speed {args.speed:g}: expected 1 with --times now, because distance and wheel speed would "
                "disagree; use --times recorded or camber replay"
            )
        channels = _chosen(args.channels, args.without)
        names, vehicle = _producers(args.files, channels)
    except (OSError, PlaybackError) as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 2
    settings = bus_settings(args, prog=_PROG, vehicle=args.vehicle or vehicle)
    try:
        check_no_producer(settings, names, channels, timeout_s=args.timeout)
        with stopped_by_signals() as stop:
            now = args.times == "now"
            player = Player(settings, names, stop, speed=args.speed, now=now, timeout_s=args.timeout)
            try:
                received = _RECEIVED_ONLY if args.channels is None else ()
                errors = player.play(_messages(args.files, (*channels, *received)))
            finally:
                player.close()
    except BusError as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 3
    except PlaybackError as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 1
    print(player.summary(), flush=True)
    for problem in errors:
        print(f"{_PROG}: {problem}", file=sys.stderr)
    return 1 if errors else 0


def check_no_producer(
    settings: ServiceSettings, producers: Collection[str], channels: Sequence[Channel], *, timeout_s: float
) -> None:
    """Raise PlaybackError where one of these producers declares liveliness, or publishes within a second."""
    with QueryClient(settings, timeout_s=timeout_s) as asker:
        alive = asker.alive(settings.vehicle).get(settings.vehicle, frozenset())
    there = {"vehicle" if name in (SENSORS, ROS2) else name for name in alive} & set(producers)
    if not there:  # a program that is not a Camber service declares no liveliness
        played = [channel for channel in channels if set(channel.producers) & set(producers)]
        with RawSubscription(settings, played, timeout_s=timeout_s) as tap:
            time.sleep(_LISTEN_S)
            there = {BY_NAME[item.channel].producers[0] for item in tap.take()}
    if there:
        names = ", ".join(sorted(there))
        same = ",".join(channel.name for channel in channels if set(channel.producers) & there)
        raise PlaybackError(
            f"{names} of {settings.vehicle} is on this bus, expected no other publisher of the same channels; "
            f"use --without {same}, or another --vehicle"
        )


class Player:
    """Publishes messages as their original producers. Raises BusError."""

    def __init__(
        self,
        settings: ServiceSettings,
        producers: Collection[str],
        stop: threading.Event,
        *,
        speed: float = 1.0,
        now: bool = True,
        timeout_s: float | None = None,
    ) -> None:
        self.played: Counter[str] = Counter()
        self.left_out: Counter[str] = Counter()
        self.late = 0
        self.latest_s = 0.0
        self._stop, self._speed, self._now = stop, speed, now
        self._clock = SystemClock()
        session = open_session(settings.zenoh, timeout_s=timeout_s)
        quiet = settings.model_copy(update={"log_level": "error"})
        self._buses = {name: Bus(session, quiet, name, self._clock) for name in sorted(producers)}
        for bus in self._buses.values():
            if not now:
                bus.set_blocking()
            bus.announce()

    def play(self, messages: Iterator[Recorded[Any] | RecordingError]) -> list[RecordingError]:
        """Publish each message when it is due, in order; returns the errors of the recording."""
        errors: list[RecordingError] = []
        first_ns: int | None = None
        began_s, offset_ns = 0.0, 0
        for item in messages:
            if isinstance(item, RecordingError):
                errors.append(item)
                continue
            if BY_NAME[item.channel] in _RECEIVED_ONLY or (self._now and item.channel == "receiver_bytes"):
                self.left_out[item.channel] += 1
                continue
            if first_ns is None:
                first_ns, began_s = item.message.time_ns, time.monotonic()
                if self._now:
                    offset_ns = (self._clock.now_ns() - first_ns) // NS_PER_FIX_ID * NS_PER_FIX_ID
            due_s = began_s + (item.message.time_ns - first_ns) / NS_PER_SECOND / self._speed
            wait_s = max(due_s - time.monotonic(), 0.0)
            if wait_s > _LONG_GAP_S:
                text = f"{_PROG}: a gap in the recording: nothing for {wait_s:.0f} s"
                print(text, file=sys.stderr, flush=True)
            if self._stop.wait(wait_s):
                break
            late_s = time.monotonic() - due_s
            if late_s > _LATE_S:
                self.late += 1
                self.latest_s = max(self.latest_s, late_s)
            message = moved(item.message, offset_ns) if offset_ns else item.message
            self._buses[BY_NAME[item.channel].producers[0]].publish(item.channel, message)
            self.played[item.channel] += 1
        return errors

    def close(self) -> None:
        """Leave the bus."""
        for bus in self._buses.values():
            bus.close()

    def summary(self) -> str:
        """Return one line with counts of played, omitted and late messages."""
        played, left_out = (
            ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
            for counts in (self.played, self.left_out)
        )
        parts = [f"played {played or 'nothing'}"]
        parts += [f"left out: {left_out}"] if left_out else []
        if self.late:
            parts.append(f"{self.late} were more than {_LATE_S} s late, {self.latest_s:.1f} s at most")
        return "; ".join(parts)


def _messages(files: Sequence[Path], channels: Sequence[Channel]) -> Iterator[Recorded[Any] | RecordingError]:
    for path in files:
        yield from read_recording(path, {channel.name for channel in channels})


def _chosen(names: str | None, without: str | None) -> tuple[Channel, ...]:
    known = [channel.name for channel in PLAYABLE]
    wanted = known if names is None else names.split(",")
    left_out = without.split(",") if without is not None else []
    for name in (*wanted, *left_out):
        if name not in known:
            raise PlaybackError(f"channel {name!r}: expected some of {', '.join(known)}")
    return tuple(c for c in PLAYABLE if c.name in wanted and c.name not in left_out)


def _producers(files: Sequence[Path], channels: Sequence[Channel]) -> tuple[set[str], str]:
    """Return the producers of these channels' messages in the files, and the vehicle in their keys.

    Raises PlaybackError where there are no messages, or messages of several vehicles: sources are never mixed.
    """
    names, vehicles = set[str](), set[str]()
    for path in files:
        for item in _messages([path], channels):
            if isinstance(item, RecordingError):
                continue
            names.add(BY_NAME[item.channel].producers[0])
            try:
                vehicles.add(BY_NAME[item.channel].vehicle_in(item.key))
            except ValueError as error:
                raise PlaybackError(f"{path}: {item.channel}: {error}") from None
    every = ", ".join(map(str, files))
    if not names:
        raise PlaybackError(f"{every}: no message of these channels that this version can read")
    if len(vehicles) > 1:
        raise PlaybackError(f"{every}: messages of {', '.join(sorted(vehicles))}, expected one vehicle")
    return names, vehicles.pop()
