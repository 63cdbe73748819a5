"""The map of a PMTiles file: vector tiles as `camber map export --to pmtiles` makes them, without a release."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from camber.formats.map_exchange.pmtiles import PmtilesFile

_MOST_CHARACTERS = 200  # chosen: of a text of the file that the page shows


class ArchivedTiles:
    """As MapTiles, but from a file; the points of clouds are not in it."""

    def __init__(self, path: Path) -> None:
        self._file, self._name = PmtilesFile(path), path.name
        self.source = self

    def tile(self, zoom: int, x: int, y: int) -> bytes:
        """A tile; empty where there is none. Raises FormatError, OSError."""
        return self._file.tile(zoom, x, y) or b""

    def points(self, _x: int, _y: int) -> bytes:
        """Nothing."""
        return b""

    def describe(self) -> dict[str, Any]:
        """As ReleaseSource."""
        given = self._file.metadata.get("camber")
        facts = given if isinstance(given, dict) else {}
        keys = ("region", "version", "datum", "surrogate")
        texts = {key: str(facts.get(key, ""))[:_MOST_CHARACTERS] for key in keys}
        return {**texts, "region": texts["region"] or self._name, "bounds": list(self._file.bounds_deg)}
