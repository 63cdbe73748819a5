"""Releases of the map: written at once or not at all, and never read where a byte is not as it was written.

    root.msgpack            ReleaseRoot: version, SHA-256 of the manifest, Ed25519 signature
    blobs/<2 hex>/<sha256>  Manifest and tiles, as `codec.encode` writes them

The trust goes from the signature over the root to the manifest's hash, and from there to that of every tile. Without a
configured key the hashes still find every fault of disk and transport, but not a forger.

A newer release may be written into the folder of its predecessor: equal tiles are there already, the root changes last,
and readers of the old one keep what they have. Blobs of older releases stay. A vehicle has the same bytes in its store
(`map_store.py`), of which some tiles may be missing: these are known to be.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from camber.road_map.release_files import (
    MAX_BLOB_BYTES,
    ROOT_NAME,
    BlobMissing,
    BlobSource,
    ReleaseFolder,
    decoded,
)
from camber.road_map.release_writer import write_release
from camber.road_map.road_columns import ReleaseError, RoadLinks, RoadSurfaces
from camber.road_map.road_tiles import links_from_tiles, surfaces_from_tiles
from camber.road_map.signing_keys import check_signature, key_id, load_public_key, load_signing_key
from camber.road_map.tile_checks import wrong_in_tile
from camber.road_map.tile_grid import TILES, Tile
from camber.schemas.road import LAYERS, CloudTile, Layer, LinkTile, Manifest, ReleaseRoot, SurfaceTile

TileT = TypeVar("TileT", SurfaceTile, LinkTile, CloudTile)


@dataclass(frozen=True, eq=False)
class Release:
    """One release; tiles are read when asked for, and verified each time.

    Every method that gives a tile raises ReleaseError where the tile is not the one that the manifest names, and of
    these BlobMissing where it has not been fetched.
    """

    source: BlobSource
    root: ReleaseRoot
    manifest: Manifest
    _rows: dict[tuple[Layer, int, int], int] = field(repr=False)

    def tiles(self, layer: Layer) -> list[Tile]:
        """The tiles of a layer, in the order of their numbers."""
        return sorted((x, y) for name, x, y in self._rows if name == layer)

    def sha256(self, layer: Layer, x: int, y: int) -> str | None:
        """The hash of a tile; None: the release has no such tile."""
        row = self._rows.get((layer, x, y))
        return None if row is None else self.manifest.sha256[row].tobytes().hex()

    def blob(self, layer: Layer, x: int, y: int) -> bytes | None:
        """The bytes of a tile; None: the release has no such tile."""
        row = self._rows.get((layer, x, y))
        return None if row is None else self._read(row)

    def surface_tile(self, x: int, y: int) -> SurfaceTile | None:
        """The road surfaces of a tile; None: the release has none there."""
        return self._tile(SurfaceTile, "surfaces", x, y)

    def link_tile(self, x: int, y: int) -> LinkTile | None:
        """The links of a tile; None: the release has none there."""
        return self._tile(LinkTile, "links", x, y)

    def cloud_tile(self, layer: Layer, x: int, y: int) -> CloudTile | None:
        """The points of a tile; None: the release has none there."""
        return self._tile(CloudTile, layer, x, y)

    def road_surfaces(self) -> RoadSurfaces:
        """All road surfaces, each once, in the order of their ids."""
        return surfaces_from_tiles(tile for xy in self.tiles("surfaces") if (tile := self.surface_tile(*xy)))

    def road_links(self) -> RoadLinks:
        """All links, each once, in the order of their ids."""
        return links_from_tiles(tile for xy in self.tiles("links") if (tile := self.link_tile(*xy)))

    def check(self, known: Collection[str] = ()) -> Iterator[int]:
        """Verify tile after tile, but for those whose hash is `known` to be right; yields the size of each."""
        for (layer, x, y), row in self._rows.items():
            digest = self.manifest.sha256[row].tobytes().hex()
            if digest not in known and self.source.to_verify(digest):
                match layer:
                    case "surfaces":
                        self.surface_tile(x, y)
                    case "links":
                        self.link_tile(x, y)
                    case _:
                        self.cloud_tile(layer, x, y)
                yield int(self.manifest.size_bytes[row])

    def hashes(self) -> frozenset[str]:
        """The hashes of all tiles."""
        return frozenset(row.tobytes().hex() for row in self.manifest.sha256)

    def _tile(self, cls: type[TileT], layer: Layer, x: int, y: int) -> TileT | None:
        row = self._rows.get((layer, x, y))
        if row is None:
            return None
        return checked_tile(cls, self._read(row), self.source.name(self._digest(row)), layer, x, y)

    def _read(self, row: int) -> bytes:
        return self.source.blob(self._digest(row), int(self.manifest.size_bytes[row]))

    def _digest(self, row: int) -> str:
        return str(self.manifest.sha256[row].tobytes().hex())


def checked_tile(cls: type[TileT], data: bytes, file: str, layer: Layer, x: int, y: int) -> TileT:
    """The tile in these bytes, which must be the one of the manifest and possible as a map; else ReleaseError."""
    tile = decoded(cls, data, file)
    if (tile.x, tile.y) != (x, y):
        raise ReleaseError(file, "x, y", f"tile {x}, {y} as in the manifest", actual=f"{tile.x}, {tile.y}")
    if isinstance(tile, CloudTile) and tile.layer != layer:
        raise ReleaseError(file, "layer", f"{layer} as in the manifest", actual=tile.layer)
    wrong = wrong_in_tile(tile)
    if wrong is not None:
        raise ReleaseError(file, *wrong)
    return tile


def open_release(source: Path | BlobSource, *, public_key: Ed25519PublicKey | None = None) -> Release:
    """The release in a folder or store with only root and manifest verified; each tile is verified when it is read.

    With `public_key` a release that is unsigned or signed with another key is refused. Raises ReleaseError only.
    """
    source = ReleaseFolder(source) if isinstance(source, Path) else source
    file = source.name(None)
    root = decoded(ReleaseRoot, source.root(), file)
    if public_key is not None:
        check_signature(root, public_key, file)
    return release_of(source, root, file)


def release_of(source: BlobSource, root: ReleaseRoot, file: str) -> Release:
    """The release that a root names, whose own trust is settled; `file` is what to call the root."""
    manifest_file = source.name(root.manifest_sha256)
    manifest = decoded(Manifest, source.blob(root.manifest_sha256, None), manifest_file)
    for name in ("region", "map_version", "time_ns"):
        if getattr(root, name) != getattr(manifest, name):
            found = str(getattr(root, name))
            raise ReleaseError(file, name, f"{getattr(manifest, name)} as in the manifest", actual=found)
    return Release(source, root, manifest, _rows_of(manifest, manifest_file))


def read_release(source: Path | BlobSource, *, public_key: Ed25519PublicKey | None = None) -> Release:
    """The release in a folder, every byte of it verified: `open_release`, and each tile read once."""
    release = open_release(source, public_key=public_key)
    for _ in release.check():
        pass
    return release


def _rows_of(manifest: Manifest, file: str) -> dict[tuple[Layer, int, int], int]:
    for name, column in (("tile_x", manifest.tile_x), ("tile_y", manifest.tile_y)):
        if not ((column >= 0) & (column < TILES)).all():
            raise ReleaseError(file, name, f"0 to {TILES - 1}")
    columns = (manifest.layer.tolist(), manifest.tile_x.tolist(), manifest.tile_y.tolist())
    if manifest.layer.size and int(manifest.layer.max()) >= len(LAYERS):
        raise ReleaseError(file, "layer", f"0 to {len(LAYERS) - 1}")
    rows = {(LAYERS[layer], x, y): row for row, (layer, x, y) in enumerate(zip(*columns, strict=True))}
    if len(rows) != len(manifest.layer):
        raise ReleaseError(file, "tile_x, tile_y, layer", "each tile of a layer once")
    return rows


__all__ = [
    "MAX_BLOB_BYTES",
    "ROOT_NAME",
    "BlobMissing",
    "BlobSource",
    "Release",
    "ReleaseError",
    "ReleaseFolder",
    "RoadLinks",
    "RoadSurfaces",
    "checked_tile",
    "key_id",
    "load_public_key",
    "load_signing_key",
    "open_release",
    "read_release",
    "release_of",
    "write_release",
]
