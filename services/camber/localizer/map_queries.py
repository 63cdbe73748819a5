"""What the localizer asks of the map, and how it hears the answers: whoever runs it brings them."""

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


class NoAnswer(NamedTuple):
    """Nobody answered, or not in time, or what came could not be read; `text` for people."""

    failure: Failure
    text: str


class MapAnswers(Protocol):
    """The map's three questions. Asking waits for the answer."""

    def elevation(self, request: ElevationRequest) -> ElevationReply | NoAnswer:
        """The road under a point."""

    def links(self, request: LinksRequest) -> LinksReply | NoAnswer:
        """The links around a point."""

    def tile(self, request: TileRequest) -> TileReply | NoAnswer:
        """A part of a tile."""

    def is_there(self) -> bool:
        """Is there anybody to ask? An old answer is worth nothing where the map itself may have gone."""


class Diagnostics(Protocol):
    """Where what is amiss is told, and what happens is counted."""

    def issue(self, code: str, text: str) -> None:
        """Something an operator should know."""

    def count(self, name: str) -> None:
        """One more of these."""
