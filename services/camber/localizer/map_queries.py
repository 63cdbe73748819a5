"""Interface of the localizer to the map and to its diagnostics; the caller implements both."""

from __future__ import annotations

from typing import Literal, NamedTuple, Protocol, TypeAlias

from camber.schemas.road import (
    ElevationReply,
    ElevationRequest,
    LinksReply,
    LinksRequest,
    TileReply,
    TileRequest,
)

Failure: TypeAlias = Literal["absent", "timeout", "refused", "invalid"]


class MapQueryFailure(NamedTuple):
    """No reply, none in time, or one that could not be decoded; `text` is for people."""

    failure: Failure
    text: str


class MapQueries(Protocol):
    """The queries to the map. Each waits for the reply."""

    def elevation(self, request: ElevationRequest) -> ElevationReply | MapQueryFailure:
        """Return the road at a position."""

    def links(self, request: LinksRequest) -> LinksReply | MapQueryFailure:
        """Return the links around a position."""

    def tile(self, request: TileRequest) -> TileReply | MapQueryFailure:
        """Return a part of a tile."""

    def is_available(self) -> bool:
        """Whether the map can be queried. Without a map its earlier replies are not used either."""


class Diagnostics(Protocol):
    """Receives issues and counters."""

    def issue(self, code: str, text: str) -> None:
        """Report a problem that an operator should know."""

    def count(self, name: str) -> None:
        """Increment a counter."""
