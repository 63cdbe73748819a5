"""Write a release of the map."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple, NotRequired, TypedDict, Unpack

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from pydantic import ValidationError

from camber.road_map.release_files import ROOT_NAME, encoded, sync_folder, write_blob, write_file
from camber.road_map.road_columns import ReleaseError, RoadLinks, RoadSurfaces
from camber.road_map.road_tiles import link_tiles, surface_tiles
from camber.road_map.signing_keys import signed
from camber.road_map.tile_checks import tile_defect
from camber.schemas.refused_field import first_refused
from camber.schemas.road import LAYERS, CloudTile, Layer, LinkTile, Manifest, ReleaseRoot, SurfaceTile

_CLOUD_LAYERS: tuple[Layer, ...] = ("environment_cloud", "road_cloud")

AnyTile = SurfaceTile | LinkTile | CloudTile
TileKey = tuple[int, int, int]
"""Index of a layer in LAYERS, tile x, tile y."""


class StoredBlob(NamedTuple):
    """A blob that the folder contains already: its SHA-256 and its size in bytes."""

    digest: bytes
    size: int


class ReleaseMetadata(TypedDict):
    """Fields of Manifest besides tiles, predecessor and lineage.

    `surrogate`: how the map was made if it was not surveyed, else empty. `time_ns`: time of making.
    """

    region: str
    map_version: int
    datum: str
    epoch_year: float
    time_ns: int
    surrogate: NotRequired[str]
    reference_sha256: NotRequired[str | None]
    corrections_sha256: NotRequired[str | None]


def write_release(
    folder: Path,
    *,
    surfaces: RoadSurfaces,
    links: RoadLinks,
    clouds: Iterable[CloudTile] = (),
    lineage: Iterable[tuple[int, int]] = (),
    previous: ReleaseRoot | None = None,
    signing_key: Ed25519PrivateKey | None = None,
    **metadata: Unpack[ReleaseMetadata],
) -> ReleaseRoot:
    """Write a release atomically and return its root. The same arguments give the same bytes, on every machine.

    `lineage`: pairs of a surface and the surface of an earlier release that it was split or merged from. Raises
    ReleaseError for invalid contents and OSError if the disk fails; the old release then remains.
    """
    tiles: list[tuple[Layer, AnyTile]] = [("surfaces", tile) for tile in surface_tiles(surfaces)]
    tiles += [("links", tile) for tile in link_tiles(links)]
    tiles += [(cloud.layer, cloud) for cloud in clouds]
    blobs: dict[TileKey, bytes] = {}
    for layer, tile in tiles:
        blobs[_place_of(layer, tile, blobs)] = encoded(tile, f"{layer} of tile {tile.x}, {tile.y}")
    pairs = sorted(set(lineage))
    missing = {child for child, _ in pairs} - set(surfaces.surface_id.tolist())
    if missing:
        raise ReleaseError("lineage", "surface", "a surface of this release", actual=str(min(missing)))
    return write_tiles_and_manifest(
        folder, blobs, lineage=pairs, previous=previous, signing_key=signing_key, **metadata
    )


def write_tiles_and_manifest(
    folder: Path,
    blobs: Mapping[TileKey, bytes | StoredBlob],
    *,
    lineage: Iterable[tuple[int, int]],
    previous: ReleaseRoot | None,
    signing_key: Ed25519PrivateKey | None,
    **metadata: Unpack[ReleaseMetadata],
) -> ReleaseRoot:
    """Write the blobs that the folder does not contain yet, then manifest and root; as `write_release`.

    A blob is given as bytes, or, if the folder contains it already, as hash and size.
    """
    region, map_version, time_ns = metadata["region"], metadata["map_version"], metadata["time_ns"]
    if previous is not None and (previous.region != region or previous.map_version >= map_version):
        expected = f"region {previous.region} and more than {previous.map_version}"
        raise ReleaseError("release", "region and map_version", expected, actual=f"{region}, {map_version}")
    entries = {place: _entry(blob) for place, blob in sorted(blobs.items())}
    places = np.array([*entries], np.int32).reshape(-1, 3)
    pairs = np.array([*lineage], np.int64).reshape(-1, 2)
    try:
        manifest = Manifest(
            **metadata,
            previous_sha256=None if previous is None else previous.manifest_sha256,
            layer=places[:, 0].astype(np.uint8),
            tile_x=places[:, 1].copy(),
            tile_y=places[:, 2].copy(),
            sha256=np.frombuffer(b"".join(entry.digest for entry in entries.values()), np.uint8).reshape(
                -1, 32
            ),
            size_bytes=np.array([entry.size for entry in entries.values()], np.int64),
            lineage_surface_id=pairs[:, 0].copy(),
            lineage_parent_id=pairs[:, 1].copy(),
        )
    except ValidationError as error:
        field = first_refused(error)
        raise ReleaseError("manifest", field.name, field.expected) from None
    head = encoded(manifest, "manifest")
    digest = hashlib.sha256(head).hexdigest()
    root = ReleaseRoot(time_ns=time_ns, region=region, map_version=map_version, manifest_sha256=digest)
    root = root if signing_key is None else signed(root, signing_key)
    for place, entry in entries.items():
        data = blobs[place]
        if isinstance(data, bytes):
            write_blob(folder, entry.digest.hex(), data)
    write_blob(folder, digest, head)
    # The folders of the blobs may be new: their names must be durable before a root refers to them.
    sync_folder(folder / "blobs")
    sync_folder(folder)
    write_file(folder / ROOT_NAME, encoded(root, "root"))
    return root


def _entry(blob: bytes | StoredBlob) -> StoredBlob:
    return blob if isinstance(blob, StoredBlob) else StoredBlob(hashlib.sha256(blob).digest(), len(blob))


def _place_of(layer: Layer, tile: AnyTile, blobs: Collection[TileKey]) -> TileKey:
    name, place = f"{layer} of tile {tile.x}, {tile.y}", (LAYERS.index(layer), tile.x, tile.y)
    if isinstance(tile, CloudTile) and layer not in _CLOUD_LAYERS:
        raise ReleaseError(name, "layer", " or ".join(_CLOUD_LAYERS), actual=layer)
    if place in blobs:
        raise ReleaseError(name, "tile", "each tile of a layer once")
    defect = tile_defect(tile)
    if defect is not None:
        raise ReleaseError(name, *defect)
    return place
