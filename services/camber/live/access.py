"""Who may see the page: this machine's own browsers, or who knows the token; and what the page itself may load."""

from __future__ import annotations

import hmac
from typing import Any
from urllib.parse import urlsplit

from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Receive, Scope, Send

COOKIE = "camber_live"
LOOPBACK = ("127.0.0.1", "localhost", "::1")
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; worker-src 'self'; connect-src 'self'{images}; "
    "img-src 'self' data: blob:{images}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class Guard:
    """Refuses what comes under a foreign name or without the token, and adds the page's security headers.

    Without a token only names of this machine are answered: a page from elsewhere cannot reach it under its own name.
    `images`: the origin of the user's own background map, the only other place from which the page may load anything.
    """

    def __init__(self, app: ASGIApp, *, token: str | None, images: str | None = None) -> None:
        self._app, self._token = app, token
        policy = _POLICY.format(images="" if images is None else f" {images}")
        self._headers = [
            (b"content-security-policy", policy.encode()),
            (b"x-content-type-options", b"nosniff"),
            (b"referrer-policy", b"no-referrer"),
            (b"cross-origin-resource-policy", b"same-origin"),
        ]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass on to the page."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)

        async def with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *self._headers]
            await send(message)

        if self._allowed(connection):
            await self._app(scope, receive, with_headers)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
        else:
            await self._answer(connection)(scope, receive, with_headers)

    def _allowed(self, connection: HTTPConnection) -> bool:
        host = connection.headers.get("host", "")
        origin = connection.headers.get("origin")
        if origin is not None and origin_of(origin) != host:
            return False
        if self._token is None:
            return _name_of(host) in LOOPBACK
        return is_same_text(connection.cookies.get(COOKIE, ""), self._token)

    def _answer(self, connection: HTTPConnection) -> ASGIApp:
        """Take a token from the address into a cookie, or say what is missing."""
        if self._token is None:
            return PlainTextResponse("this page is for browsers on its own machine", 403)
        if not is_same_text(connection.query_params.get("token", ""), self._token):
            return PlainTextResponse("open the address with ?token=… that camber live printed", 403)
        response = RedirectResponse("/", 303)
        response.set_cookie(
            COOKIE, self._token, httponly=True, samesite="strict", secure=connection.url.scheme == "https"
        )
        return response


def is_same_text(given: str, token: str) -> bool:
    """Return whether a secret is the one given, in a time that does not depend on where they differ."""
    return hmac.compare_digest(given.encode(), token.encode())


def origin_of(origin: str) -> str:
    """Host and port of an origin, empty where it has none."""
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return ""


def _name_of(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""
