"""`camber live`: a web page of what is on the bus, of a recording, or of a finished replay.

    camber live                     the vehicle on the bus
    camber live out/demo            a run of `camber replay` or `camber demo`, with its truth and its map
    camber live --fleet             all vehicles on the bus, and the services of the cloud
    camber live --fleet --review ann.key    the same; changes of the map can be decided, signed with this key
    camber live drive.mcap          a recording of `camber record`; --map gives it a map

The page is for browsers on this machine. Another address is served only with --token, and over TLS where a certificate
is given. Without a token only requests to this machine's names are answered, in a container too. The page only shows,
but with --review: then it always has a token, and on another address TLS too.
"""

from __future__ import annotations

import argparse
import gc
import os
import secrets
import socket
import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote, urlsplit

import uvicorn

from camber.formats.errors import FormatError
from camber.live.access import LOOPBACK
from camber.live.archived_tiles import ArchivedTiles
from camber.live.history import HOUR_ROWS, History
from camber.live.map_tiles import MapTiles, ReleaseSource
from camber.live.rows import LAYOUTS, RowWriter
from camber.live.sources import BusSource, RecordingSource
from camber.live.web_server import LiveState, application
from camber.road_map.release import ReleaseError, load_signing_key, open_release
from camber.schemas.channels import SERVICES, VEHICLE_SERVICES
from camber.tools.options.bus_options import add_bus_options, bus_settings
from camber.tools.options.number_options import whole_from
from camber.tools.options.parsers import add_with_default, tool_parser

_PROG = "camber live"
FLEET = "fleet"
"""The cloud's name where a vehicle's stands, as for `camber status`."""
_PORT = 8080  # chosen: what people type
_TOKEN_VARIABLE = "CAMBER_LIVE_TOKEN"
_LEAST_TOKEN = 16
"""Characters. Chosen: nobody guesses it over a network."""
_RECORDING_ROWS = 6 * HOUR_ROWS
"""Of a recording. Chosen: six hours; of a longer one the beginning is left out."""
_PING_S = 10.0  # chosen: a browser that does not answer for so long has its connection closed
_HELP = f"""\
exit codes: 0 ended by a signal; 2 wrong usage, or a file that cannot be read.
A token can be given in the environment too, as {_TOKEN_VARIABLE}.
"""


def main(argv: Sequence[str]) -> int:
    """Serve until a signal."""
    args = _parser().parse_args(argv)
    token = args.token or os.environ.get(_TOKEN_VARIABLE) or None
    if args.review is not None and token is None:
        token = secrets.token_urlsafe(_LEAST_TOKEN)
    try:
        _check(args, token)
        state = _state(args)
        listening = _listen(args.host, args.port)
    except (ValueError, FormatError) as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{_PROG}: {error.filename or f'{args.host}:{args.port}'}: {error.strerror}", file=sys.stderr)
        return 2
    address = _address(args, listening, token)
    state.source.start()
    watches = [watch for watch in (state.health, state.changes) if watch is not None]
    for watch in watches:
        watch.start()
    gc.freeze()  # what is loaded stays
    print(f"{_PROG}: {state.title}: {address}", flush=True)
    if args.open:
        webbrowser.open(address)
    try:
        _serve(args, state, listening, token)
    finally:
        state.source.end()
        for watch in watches:
            watch.end()
    return 0


def _state(args: argparse.Namespace) -> LiveState:
    """The source and what goes with it. Raises FormatError, OSError."""
    if args.fleet:
        return _fleet(args)
    if args.path is None:
        return _bus(args)
    return _run_folder(args) if args.path.is_dir() else _recording(args)


def _bus(args: argparse.Namespace) -> LiveState:
    from camber.live.bus_map import BusMap
    from camber.live.health_watch import HealthWatch

    settings = bus_settings(args, prog=_PROG, vehicle=args.vehicle)
    history = History(LAYOUTS)
    tiles = MapTiles(BusMap(settings)) if args.map is None else _tiles(args.map)
    return LiveState(
        title=settings.vehicle,
        history=history,
        source=BusSource(settings, RowWriter(history)),
        tiles=tiles,
        health=HealthWatch(settings),
        raster=args.raster,
    )


def _fleet(args: argparse.Namespace) -> LiveState:
    from camber.live.fleet import FleetSource
    from camber.live.health_watch import HealthWatch, MapChangesWatch
    from camber.live.review import MapReview
    from camber.tools.maps.road_names import road_names

    settings = bus_settings(args, prog=_PROG, vehicle=FLEET)
    key = None if args.review is None else load_signing_key(args.review)
    return LiveState(
        title=FLEET,
        history=History(LAYOUTS, 1),
        source=FleetSource(settings),
        tiles=None if args.map is None else _tiles(args.map),
        health=HealthWatch(settings, [name for name in SERVICES if name not in VEHICLE_SERVICES]),
        changes=MapChangesWatch(settings, {} if args.roads is None else road_names(args.roads)),
        review=MapReview(settings, key),
        raster=args.raster,
    )


def _recording(args: argparse.Namespace) -> LiveState:
    with args.path.open("rb"):
        pass
    history = History(LAYOUTS, _RECORDING_ROWS)
    return LiveState(
        title=args.path.name,
        history=history,
        source=RecordingSource(args.path, RowWriter(history)),
        tiles=None if args.map is None else _tiles(args.map),
        raster=args.raster,
    )


def _run_folder(args: argparse.Namespace) -> LiveState:
    from camber.replay.run_folder import RunFolder

    folder = RunFolder(args.path)
    facts, run = folder.read_drive(), folder.read_run()
    truth = folder.read_truth() if facts.truth else None
    history = History(LAYOUTS, _RECORDING_ROWS)
    place = args.map or folder.map_release(facts)
    problem, tiles = "", None
    try:
        tiles = None if place is None else _tiles(place)
    except ReleaseError as error:
        problem = str(error)
    with folder.recording_path.open("rb"):
        pass
    return LiveState(
        title=facts.drive,
        history=history,
        source=RecordingSource(folder.recording_path, RowWriter(history, truth, facts.offset_enu_m)),
        tiles=tiles,
        map_problem=problem,
        raster=args.raster,
        notes=(*facts.surrogates, *run.notes),
    )


def _tiles(path: Path) -> MapTiles | ArchivedTiles:
    return ArchivedTiles(path) if path.is_file() else MapTiles(ReleaseSource(open_release(path)))


def _check(args: argparse.Namespace, token: str | None) -> None:
    if args.host not in LOOPBACK and token is None and not args.published_on_loopback:
        raise ValueError(f"--host {args.host}: others can reach this address, so --token is needed")
    if token is not None and len(token) < _LEAST_TOKEN:
        raise ValueError(f"--token: expected at least {_LEAST_TOKEN} characters")
    if args.fleet and (args.path is not None or args.vehicle is not None):
        raise ValueError("--fleet: expected neither a file nor --vehicle with it")
    for name in ("review", "roads"):
        if getattr(args, name) is not None and not args.fleet:
            raise ValueError(f"--{name}: expected with --fleet")
    if (
        args.review is not None
        and args.host not in LOOPBACK
        and not args.published_on_loopback
        and args.certificate is None
    ):
        raise ValueError(f"--host {args.host}: with --review expected --certificate and --key for TLS")
    if (args.certificate is None) != (args.key is None):
        raise ValueError("--certificate and --key: expected both or none")
    if args.raster is not None and urlsplit(args.raster).scheme not in ("http", "https"):
        raise ValueError(f"--raster {args.raster}: expected an address with {{z}}, {{x}} and {{y}}")


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if sys.platform == "linux":  # RFC 5482; a close by the keepalive waits for a browser that reads nothing
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(2 * _PING_S * 1000))
    try:
        listening.bind((host, port))
        listening.listen()  # who opens the page as soon as its address is printed waits, and is not refused
    except OSError:
        listening.close()
        raise
    return listening


def _address(args: argparse.Namespace, listening: socket.socket, token: str | None) -> str:
    host = "localhost" if args.published_on_loopback else args.host
    name = f"[{host}]" if ":" in host else host
    scheme = "http" if args.certificate is None else "https"
    end = "/" if token is None else f"/?token={quote(token, safe='')}"
    return f"{scheme}://{name}:{listening.getsockname()[1]}{end}"


def _serve(args: argparse.Namespace, state: LiveState, listening: socket.socket, token: str | None) -> None:
    raster = None if args.raster is None else urlsplit(args.raster)
    images = None if raster is None else f"{raster.scheme}://{raster.netloc}"
    config = uvicorn.Config(
        application(state, token=token, images=images),
        log_level="warning",
        access_log=False,
        ws="websockets-sansio",
        ws_ping_interval=_PING_S,
        ws_ping_timeout=_PING_S,
        ws_max_size=1024,  # a browser has nothing to say
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
        ssl_certfile=args.certificate,
        ssl_keyfile=args.key,
        server_header=False,
    )
    uvicorn.Server(config).run(sockets=[listening])


def _parser() -> argparse.ArgumentParser:
    parser = tool_parser(_PROG, __doc__, _HELP)
    add = parser.add_argument
    add(
        "path",
        type=Path,
        nargs="?",
        metavar="DIR|FILE",
        help="folder of a run, or a recording (default: the bus)",
    )
    add("--fleet", action="store_true", help="all vehicles on the bus")
    text = "decide on changes of the map: the operator's Ed25519 key, which signs (with --fleet)"
    add("--review", type=Path, metavar="KEYFILE", help=text)
    text = "names of roads for --fleet: the .geojson or OpenStreetMap file that the map was made along"
    add("--roads", type=Path, metavar="FILE", help=text)
    add("--vehicle", metavar="V", help="name of the vehicle on the bus (default: that of --config)")
    add_bus_options(parser)
    add(
        "--map",
        type=Path,
        metavar="DIR|FILE.pmtiles",
        help="release of the map, or its tiles (default: that of the run or of the vehicle)",
    )
    add_with_default(parser, "--host", "127.0.0.1", "address to serve on", metavar="ADDRESS")
    add_with_default(
        parser, "--port", _PORT, "port to serve on, 0: any", type=whole_from(0, 65_535), metavar="N"
    )
    add(
        "--published-on-loopback",
        action="store_true",
        help="in a container: this machine publishes the port on a loopback address only, so no token is needed",
    )
    add("--token", metavar="TEXT", help="what a browser must know; needed on any other address")
    add("--certificate", type=Path, metavar="FILE", help="serve over TLS with this certificate")
    add("--key", type=Path, metavar="FILE", help="the certificate's private key")
    add("--raster", metavar="URL", help="images behind the map: an address with {z}, {x} and {y}")
    add("--open", action="store_true", help="open the page in the browser")
    return parser
