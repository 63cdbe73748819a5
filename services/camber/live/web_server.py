"""The page and its data over HTTP, and one WebSocket for each browser.

A browser gets a greeting and the services' health as JSON, and rows of the history as bytes (`History.batch`), at most
ten times a second. Nothing waits for a browser: one that takes its last message slowly gets no other until then, and
then what the history still has.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from camber.formats.errors import FormatError
from camber.live.access import Guard
from camber.live.archived_tiles import ArchivedTiles
from camber.live.fleet import FleetSource
from camber.live.health_watch import HealthWatch, MapChangesWatch
from camber.live.history import Cursor, History, columns_of
from camber.live.map_tiles import MapTiles
from camber.live.review import HEADER, MOST_BYTES, Answer, MapReview
from camber.live.rows import TERMS
from camber.live.runbook import runbook_entries
from camber.live.sources import Source
from camber.road_map.tile_checks import MAX_ID
from camber.road_map.tile_grid import TILES

STATIC = Path(__file__).with_name("static")
PERIOD_S = 0.1
"""Between batches, which is faster than anybody sees."""
_LOOK_S = 0.02
"""How often new rows are looked for once a batch may be sent. Chosen: a fifth of the period, the most that an epoch at
10 Hz then waits; the first look is as much earlier, so that batches keep pace with epochs."""
_ROWS = 1000
"""Of a table in one message. Chosen: a quarter of a megabyte, so that a hundred stalled browsers hold some tens."""
_BROWSERS = 128  # chosen: more than anybody opens; each costs a socket and a message
_SHARED = 8  # batches kept for browsers that stand at the same place
_TILE_TYPE = "application/vnd.mapbox-vector-tile"
_BUSY = 1013  # RFC 6455 and its registry: try again later
_BROKEN = 1006  # RFC 6455, section 7.4.1: closed without a close frame


@dataclass(kw_only=True)
class LiveState:
    """All that the page shows."""

    title: str
    history: History
    source: Source | FleetSource
    tiles: MapTiles | ArchivedTiles | None = None
    map_problem: str = ""
    health: HealthWatch | None = None
    changes: MapChangesWatch | None = None
    review: MapReview | None = None
    raster: str | None = None
    notes: tuple[str, ...] = ()
    browsers: int = 0
    _status: tuple[float, str] = (-1.0, "")
    _batches: OrderedDict[tuple[Cursor, int], tuple[bytes | None, Cursor]] = field(
        default_factory=OrderedDict
    )

    def greeting(self) -> dict[str, Any]:
        """What a browser must know before the first row."""
        facts = None if self.tiles is None else self.tiles.source.describe()
        return {
            "kind": "greeting",
            "title": self.title,
            "mode": self.source.mode,
            "columns": columns_of(self.history.layouts),
            "terms": TERMS,
            "map": facts,
            "map_problem": self.map_problem,
            "raster": self.raster,
            "notes": self.notes,
            "health": self.health is not None,
            "review": None if self.review is None else self.review.token,
        }

    def status(self) -> dict[str, Any]:
        """What changes besides the rows."""
        return {
            "kind": "status",
            "state": self.source.state,
            "problem": self.source.problem,
            # Of a recording that has been read: how many rows there are, so that the page knows when it has all.
            "rows": self.history.cursor().rows if self.source.state == "complete" else None,
            "left_out": self.source.left_out() | {"late": self.history.late},
            "browsers": self.browsers,
            "health": None if self.health is None else self.health.view,
            "vehicles": [] if self.health is None else self.health.vehicles,
        }

    def status_text(self) -> str:
        """`status` as JSON, made once for all browsers of a batch."""
        now_s = time.monotonic()
        if now_s - self._status[0] >= 0.5 * PERIOD_S:
            self._status = now_s, json.dumps(self.status())
        return self._status[1]

    def fleet(self, number: int) -> tuple[str | None, int]:
        """All vehicles, as JSON, where something has come since this number; and the number now."""
        if not isinstance(self.source, FleetSource) or self.source.number == number:
            return None, number
        number = self.source.number
        return json.dumps({"kind": "fleet", "vehicles": self.source.vehicles()}), number

    def map_changes(self, number: int) -> tuple[str | None, int]:
        """Changes of the map, as JSON, where they are others than those of this number; and the number now."""
        if self.changes is None or self.changes.number == number:
            return None, number
        number = self.changes.number
        return json.dumps({"kind": "changes", "changes": self.changes.view}), number

    def batch(self, cursor: Cursor) -> tuple[bytes | None, Cursor]:
        """As `History.batch`; browsers at the same place share one."""
        newest = self.history.appended
        key = cursor, newest
        if key not in self._batches:
            self._batches[key] = self.history.batch(cursor, _ROWS)
            if len(self._batches) > _SHARED:
                self._batches.popitem(last=False)
        return self._batches[key]


def application(state: LiveState, *, token: str | None, images: str | None = None) -> Starlette:
    """The web application; `images`: the origin of the user's own background map."""

    async def page(_: Request) -> Response:
        return FileResponse(STATIC / "index.html", headers={"cache-control": "no-cache"})

    async def tile(request: Request) -> Response:
        return await _tile(state, request.path_params)

    async def points(request: Request) -> Response:
        return await _points(state, request.path_params)

    async def verdict(request: Request) -> Response:
        text = state.history.text(request.path_params["generation"], request.path_params["row"])
        return JSONResponse({"detail": text}, 200 if text is not None else 404)

    async def snapshot(request: Request) -> Response:
        kind, time_s = request.path_params["kind"], request.path_params["time_s"]
        data = state.history.snapshots.at(kind, time_s)
        # Without one: an empty answer, which a browser does not report as a failure.
        return (
            Response(status_code=204)
            if data is None
            else Response(data, headers={"cache-control": "no-store"})
        )

    async def runbook(_: Request) -> Response:
        return JSONResponse(runbook_entries())

    async def votes(request: Request) -> Response:
        review, surface_id = state.review, request.path_params["surface_id"]
        if review is None or surface_id > MAX_ID:
            return Response(status_code=404)
        return _answered(await asyncio.to_thread(review.votes, surface_id))

    async def decision(request: Request) -> Response:
        return await _decide(state.review, request)

    async def socket(websocket: WebSocket) -> None:
        await _serve(state, websocket)

    return Starlette(
        routes=[
            Route("/", page),
            Route("/map/{zoom:int}/{x:int}/{y:int}.mvt", tile),
            Route("/points/{x:int}/{y:int}", points),
            Route("/verdict/{generation:int}/{row:int}", verdict),
            Route("/snapshot/{kind}/{time_s:float}", snapshot),
            Route("/runbook", runbook),
            Route("/votes/{surface_id:int}", votes),
            Route("/decision", decision, methods=["POST"]),
            WebSocketRoute("/stream", socket),
            Mount("/static", StaticFiles(directory=STATIC)),
        ],
        middleware=[Middleware(Guard, token=token, images=images)],
    )


async def _decide(review: MapReview | None, request: Request) -> Response:
    """Carry a decision out, once the request is known to be of this page."""
    if review is None:
        return Response(status_code=404)
    headers = request.headers
    refusal = review.refusal(
        host=headers.get("host", ""), origin=headers.get("origin"), token=headers.get(HEADER, "")
    )
    if refusal is not None:
        return _answered(Answer(403, {"reason": refusal}))
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > MOST_BYTES:
            return _answered(Answer(413, {"reason": f"expected at most {MOST_BYTES} bytes"}))
    return _answered(await asyncio.to_thread(review.decide, body))


def _answered(answer: Answer) -> Response:
    return JSONResponse(answer.content, answer.code, headers={"cache-control": "no-store"})


async def _tile(state: LiveState, place: dict[str, int]) -> Response:
    tiles = state.tiles
    if tiles is None:
        return Response(status_code=404)
    return await _of_map(state, lambda: tiles.tile(place["zoom"], place["x"], place["y"]), _TILE_TYPE)


async def _points(state: LiveState, place: dict[str, int]) -> Response:
    tiles = state.tiles
    if tiles is None or not max(place.values()) < TILES:
        return Response(status_code=404)
    return await _of_map(state, lambda: tiles.points(place["x"], place["y"]), "application/octet-stream")


async def _of_map(state: LiveState, make: Callable[[], bytes], media_type: str) -> Response:
    """What is made of the map, in a thread of its own, or what is wrong with it."""
    try:
        data = await asyncio.to_thread(make)
    except (FormatError, OSError) as error:
        state.map_problem = str(error)
        return JSONResponse({"problem": str(error)}, 503)
    return Response(data, media_type=media_type, headers={"cache-control": "no-store"})


async def _serve(state: LiveState, websocket: WebSocket) -> None:
    await websocket.accept()
    if state.browsers >= _BROWSERS:
        await websocket.close(_BUSY)
        return
    state.browsers += 1
    ended = asyncio.create_task(_until_closed(websocket))
    try:
        await _put(websocket, json.dumps(state.greeting()))
        await _send(state, websocket, ended)
    except WebSocketDisconnect:
        pass
    finally:
        state.browsers -= 1
        ended.cancel()


async def _send(state: LiveState, websocket: WebSocket, ended: asyncio.Task[None]) -> None:
    cursor, status, number, changes_number = state.history.start(), "", -1, 0
    while not ended.done():
        data, cursor = state.batch(cursor)
        if data is not None:
            await _put(websocket, data)
        fleet, number = state.fleet(number)
        if fleet is not None:
            await _put(websocket, fleet)
        changes, changes_number = state.map_changes(changes_number)
        if changes is not None:
            await _put(websocket, changes)
        newest = state.status_text()
        if newest != status:
            status = newest
            await _put(websocket, status)
        lacks_rows = cursor.rows != state.history.cursor().rows
        if data is not None and lacks_rows:
            wait_s = 0.0
        else:
            wait_s = _LOOK_S if data is None and fleet is None else PERIOD_S - _LOOK_S
        await asyncio.wait({ended}, timeout=wait_s)


async def _put(websocket: WebSocket, data: str | bytes) -> None:
    try:
        await (websocket.send_text(data) if isinstance(data, str) else websocket.send_bytes(data))
    except RuntimeError as error:
        # uvicorn, once its keepalive has closed a connection whose buffer the browser has not read to its end.
        raise WebSocketDisconnect(_BROKEN) from error


async def _until_closed(websocket: WebSocket) -> None:
    """Read and ignore: a browser has nothing to say; ends when it leaves."""
    try:
        while (await websocket.receive())["type"] != "websocket.disconnect":
            pass
    except RuntimeError:  # it was closed before
        pass
