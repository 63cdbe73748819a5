"""`camber foxglove`: what is on a vehicle's bus, live for Foxglove and Lichtblick, as `camber record` writes it.

Open a Foxglove WebSocket connection to ws://localhost:8765 and import the layout deploy/foxglove/camber.json. The
protocol has no passwords, so only this machine can connect: from another one use `ssh -L 8765:localhost:8765 VEHICLE`.
Nothing that a viewer sends is read. A viewer that is too slow loses the oldest messages.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import foxglove
from foxglove.websocket import Capability, ServerListener, WebSocketServer

from camber.formats.drive.viewer_messages import ViewerChannel, ViewerMessage, ViewerMessages, viewer_message
from camber.formats.errors import FormatError
from camber.road_map.release import open_release
from camber.road_map.road_drawing import draw_roads
from camber.runtime.raw_subscription import RawSample, RawSubscription
from camber.runtime.session import BusError
from camber.schemas.channels import CHANNELS
from camber.tools.options.bus_options import add_bus_options, bus_settings
from camber.tools.options.number_options import SECONDS, whole_from
from camber.tools.options.parsers import add_with_default, tool_parser
from camber.tools.options.stop_signals import stopped_by_signals

_PROG = "camber foxglove"
_PORT = 8765  # of Foxglove
_EVERY_S = 0.05  # chosen: seen as immediate, few wake-ups
_MOST_SAMPLES = 500
"""Read in one round. Chosen: fifty times what a vehicle publishes within it; of a flood the oldest are left out."""
_MOST_TOPICS = 256  # chosen: five times those of a vehicle; a hostile peer can name ever new schemas
_LIMIT_BYTES = 64 << 20  # chosen: a second of sweeps of several sensors, and no more of a flood
_KEPT_TOPICS = frozenset({"/map/roads", "/integrity/position/track"})
"""Sent again to each viewer that comes later: they change seldom or never."""
_HELP = "exit codes: 0 ended by a signal; 2 wrong usage, no such map, or the port is in use; 3 no bus."


def main(argv: Sequence[str]) -> int:
    """Serve until a signal."""
    args = _parser().parse_args(argv)
    settings = bus_settings(args, prog=_PROG, vehicle=args.vehicle)
    channels = [c for c in CHANNELS if c.delivery == "small" or (c.delivery == "bulk" and not args.no_sweeps)]
    try:
        roads = None if args.map is None else draw_roads(open_release(args.map).road_links())
        viewers = Viewers(
            settings.vehicle, args.port, host="0.0.0.0" if args.published_on_loopback else "127.0.0.1"
        )
    except (FormatError, OSError, RuntimeError) as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 2
    try:
        if roads is not None:
            viewers.show(viewer_message(roads, time.time_ns()))
        with (
            RawSubscription(settings, channels, timeout_s=args.timeout, limit_bytes=_LIMIT_BYTES) as tap,
            stopped_by_signals() as stop,
        ):
            print(f"{_PROG}: {settings.vehicle}: ws://localhost:{viewers.port}", flush=True)
            while not stop.wait(_EVERY_S):
                viewers.take(tap.take())
    except BusError as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 3
    finally:
        viewers.close()
    for text in viewers.left_out(tap):
        print(f"{_PROG}: {text}", file=sys.stderr)
    return 0


class Viewers:
    """A WebSocket server. Raises RuntimeError where the port is in use."""

    def __init__(self, name: str, port: int, *, host: str = "127.0.0.1") -> None:
        self.flood = self.malformed = 0
        self._messages = ViewerMessages()
        self._context = foxglove.Context()
        self._channels: dict[tuple[str, str], foxglove.Channel] = {}
        self._kept: dict[str, ViewerMessage] = {}
        self._wanted: set[str] = set()
        self._lock = threading.Lock()
        self._newest_ns = 0
        self._server: WebSocketServer = foxglove.start_server(
            name=f"Camber: {name}",
            host=host,
            port=port,
            capabilities=[Capability.Time],
            server_listener=_Subscriptions(self._wanted, self._lock),
            context=self._context,
        )

    @property
    def port(self) -> int:
        """The port that is served."""
        return self._server.port

    def close(self) -> None:
        """End all connections."""
        self._server.stop()

    def take(self, samples: Sequence[RawSample]) -> None:
        """Show what has come from the bus, and to new viewers what changes seldom."""
        left_out = max(len(samples) - _MOST_SAMPLES, 0)
        self.flood += left_out
        for sample in samples[left_out:]:
            try:
                messages = list(self._messages.of(sample.channel, sample.key, sample.data))
            except (ValueError, RecursionError):
                self.malformed += 1
                continue
            for message in messages:
                self.show(message)
        with self._lock:
            wanted = self._wanted & self._kept.keys()
            self._wanted.clear()
        for topic in sorted(wanted):
            self.show(self._kept[topic])
        if samples:
            self._server.broadcast_time(self._newest_ns)

    def show(self, message: ViewerMessage) -> None:
        """Send one message to all viewers that have asked for its topic."""
        channel = self._channel(message.channel)
        if channel is None:
            self.malformed += 1
            return
        if message.channel.topic in _KEPT_TOPICS:
            self._kept[message.channel.topic] = message
        self._newest_ns = max(self._newest_ns, message.log_ns)
        channel.log(message.data, log_time=message.log_ns)

    def left_out(self, tap: RawSubscription) -> list[str]:
        """Return one line of what was not shown, if anything."""
        counts = {"of a flood": self.flood + tap.dropped.total(), "malformed": self.malformed}
        texts = [f"{count} {name}" for name, count in counts.items() if count]
        return [f"not shown: {', '.join(texts)}"] if texts else []

    def _channel(self, described: ViewerChannel) -> foxglove.Channel | None:
        name = (described.topic, described.schema)
        if name not in self._channels:
            if len(self._channels) >= _MOST_TOPICS:
                return None
            encoding, text = described.described_by()
            schema = foxglove.Schema(name=described.schema, encoding=encoding, data=text)
            self._channels[name] = foxglove.Channel(
                described.topic, schema=schema, message_encoding=described.encoding, context=self._context
            )
        return self._channels[name]


class _Subscriptions(ServerListener):
    """Notes to which topics viewers have subscribed; called from the server's threads."""

    def __init__(self, wanted: set[str], lock: threading.Lock) -> None:
        self._wanted, self._lock = wanted, lock

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Note a topic."""
        with self._lock:
            self._wanted.add(channel.topic)


def _parser() -> argparse.ArgumentParser:
    parser = tool_parser(_PROG, __doc__, _HELP)
    parser.add_argument("--vehicle", metavar="V", help="name of the vehicle (default: that of --config)")
    add_bus_options(parser)
    parser.add_argument("--map", type=Path, metavar="DIR", help="release of the map, whose roads are shown")
    add_with_default(
        parser, "--port", _PORT, "port to serve on, 0: any", type=whole_from(0, 65_535), metavar="N"
    )
    parser.add_argument(
        "--published-on-loopback",
        action="store_true",
        help="in a container: serve on every address; this machine publishes the port on a loopback address only",
    )
    parser.add_argument("--no-sweeps", action="store_true", help="leave out sweeps, 1 MB each")
    parser.add_argument(
        "--timeout", type=SECONDS, metavar="S", help="timeout for joining the bus (default: wait)"
    )
    return parser
