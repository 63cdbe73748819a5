"""Open and verify releases of the map.

    root.msgpack            ReleaseRoot: version, SHA-256 of the manifest, Ed25519 signature
    blobs/<2 hex>/<sha256>  Manifest and tiles, as `codec.encode` writes them

The signature covers the root, the root holds the hash of the manifest, and the manifest the hash of every tile. Without
a public key the hashes still detect every fault of disk and transport, but not a forgery.

A newer release may be written into the folder of its predecessor: equal tiles exist already, the root is replaced last,
and blobs of older releases stay. A vehicle has the same bytes in its store (`store.py`), possibly without some tiles.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, cast

from camber.road_map.release_files import (
    MAX_BLOB_BYTES,
    ROOT_NAME,
    BlobMissingError,
    BlobSource,
    ReleaseFolder,
    decoded,
)
from camber.road_map.release_writer import write_release
from camber.road_map.road_columns import ReleaseError, RoadLinks, RoadSurfaces
from camber.road_map.road_tiles import links_from_tiles, surfaces_from_tiles
from camber.road_map.signing_keys import (
    TrustedKey,
    check_signature,
    key_id,
    load_public_key,
    load_signing_key,
)
from camber.road_map.tile_checks import tile_defect
from camber.road_map.tile_grid import TILES, Tile
from camber.schemas.road import LAYERS, CloudTile, Layer, LinkTile, Manifest, ReleaseRoot, SurfaceTile

AnyTile = SurfaceTile | LinkTile | CloudTile


class ReleaseTile(NamedTuple):
    """Place and size of a tile's blob."""

    layer: Layer
    x: int
    y: int
    size_bytes: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Release:
    """One release; tiles are read and verified on each access.

    Methods that return a tile raise ReleaseError if the tile is not the one that the manifest names, and
    BlobMissingError, one of these, if it has not been downloaded.
    """

    source: BlobSource
    root: ReleaseRoot
    manifest: Manifest
    _rows: dict[tuple[Layer, int, int], int] = field(repr=False)

    def tiles(self, layer: Layer) -> list[Tile]:
        """Return the tiles of a layer, in the order of their numbers."""
        return sorted((x, y) for name, x, y in self._rows if name == layer)

    def sha256(self, layer: Layer, x: int, y: int) -> str | None:
        """Return the hash of a tile; None if the release has no such tile."""
        row = self._rows.get((layer, x, y))
        return None if row is None else self._digest(row)

    def blob(self, layer: Layer, x: int, y: int) -> bytes | None:
        """Return the bytes of a tile; None if the release has no such tile."""
        row = self._rows.get((layer, x, y))
        return None if row is None else self._read(row)

    def surface_tile(self, x: int, y: int) -> SurfaceTile | None:
        """Return the road surfaces of a tile; None if the release has none there."""
        return cast("SurfaceTile | None", self.tile("surfaces", x, y))

    def link_tile(self, x: int, y: int) -> LinkTile | None:
        """Return the links of a tile; None if the release has none there."""
        return cast("LinkTile | None", self.tile("links", x, y))

    def cloud_tile(self, layer: Layer, x: int, y: int) -> CloudTile | None:
        """Return the points of a tile; None if the release has none there."""
        return cast("CloudTile | None", self.tile(layer, x, y))

    def tile(self, layer: Layer, x: int, y: int) -> AnyTile | None:
        """Return a tile of any layer; None if the release has no such tile."""
        row = self._rows.get((layer, x, y))
        if row is None:
            return None
        return decode_tile(layer, self._read(row), file=self.source.name(self._digest(row)), tile=(x, y))

    def road_surfaces(self) -> RoadSurfaces:
        """Return all road surfaces, each once, in the order of their ids."""
        return surfaces_from_tiles(tile for xy in self.tiles("surfaces") if (tile := self.surface_tile(*xy)))

    def road_links(self) -> RoadLinks:
        """Return all links, each once, in the order of their ids."""
        return links_from_tiles(tile for xy in self.tiles("links") if (tile := self.link_tile(*xy)))

    def check(self, known: Collection[str] = ()) -> Iterator[int]:
        """Verify tile after tile, except those whose hash is in `known`; yields the size of each."""
        for name, row in self._rows.items():
            digest = self._digest(row)
            if digest not in known and self.source.to_verify(digest):
                self.tile(*name)
                yield int(self.manifest.size_bytes[row])

    def hashes(self) -> frozenset[str]:
        """Return the hashes of all tiles."""
        return frozenset(map(self._digest, range(len(self.manifest.sha256))))

    def tiles_by_hash(self) -> dict[str, ReleaseTile]:
        """Return the tiles of all layers by their hashes, in the order of the manifest."""
        sizes = self.manifest.size_bytes.tolist()
        return {self._digest(row): ReleaseTile(*name, sizes[row]) for name, row in self._rows.items()}

    def _read(self, row: int) -> bytes:
        return self.source.blob(self._digest(row), int(self.manifest.size_bytes[row]))

    def _digest(self, row: int) -> str:
        return str(self.manifest.sha256[row].tobytes().hex())


def decode_tile(layer: Layer, data: bytes, *, file: str, tile: Tile) -> AnyTile:
    """Decode a tile of a layer; ReleaseError if it is not the tile `tile` or its contents are impossible."""
    cls = SurfaceTile if layer == "surfaces" else LinkTile if layer == "links" else CloudTile
    decoded_tile = decoded(cls, data, file)
    assert isinstance(decoded_tile, cls)
    x, y = decoded_tile.x, decoded_tile.y
    if (x, y) != tile:
        raise ReleaseError(file, "x, y", f"tile {tile[0]}, {tile[1]} as in the manifest", actual=f"{x}, {y}")
    if isinstance(decoded_tile, CloudTile) and decoded_tile.layer != layer:
        raise ReleaseError(file, "layer", f"{layer} as in the manifest", actual=decoded_tile.layer)
    defect = tile_defect(decoded_tile)
    if defect is not None:
        raise ReleaseError(file, *defect)
    return decoded_tile


def open_release(source: Path | BlobSource, *, public_key: TrustedKey | None = None) -> Release:
    """Open the release in a folder or store; verifies root and manifest, and each tile when it is read.

    With `public_key` a release that is unsigned or signed with another key is refused. Raises ReleaseError only.
    """
    source = ReleaseFolder(source) if isinstance(source, Path) else source
    file = source.name(None)
    root = decoded(ReleaseRoot, source.root(), file)
    if public_key is not None:
        check_signature(root, public_key, file)
    return release_of(source, root, file)


def release_of(source: BlobSource, root: ReleaseRoot, file: str) -> Release:
    """Open the release of a root that has been verified; `file` names the root in errors."""
    manifest_file = source.name(root.manifest_sha256)
    manifest = decoded(Manifest, source.blob(root.manifest_sha256, None), manifest_file)
    for name in ("region", "map_version", "time_ns"):
        if getattr(root, name) != getattr(manifest, name):
            expected = f"{getattr(manifest, name)} as in the manifest"
            raise ReleaseError(file, name, expected, actual=str(getattr(root, name)))
    return Release(source=source, root=root, manifest=manifest, _rows=_rows_of(manifest, manifest_file))


def read_release(source: Path | BlobSource, *, public_key: TrustedKey | None = None) -> Release:
    """Open a release and verify every tile."""
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
    "BlobMissingError",
    "BlobSource",
    "Release",
    "ReleaseError",
    "ReleaseFolder",
    "RoadLinks",
    "RoadSurfaces",
    "decode_tile",
    "key_id",
    "load_public_key",
    "load_signing_key",
    "open_release",
    "read_release",
    "release_of",
    "write_release",
]
