"""Write a release of the map."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from pydantic import ValidationError

from camber.road_map.release_files import ROOT_NAME, encoded, sync_folder, write_blob, write_file
from camber.road_map.road_columns import ReleaseError, RoadLinks, RoadSurfaces
from camber.road_map.road_tiles import link_tiles, surface_tiles
from camber.road_map.signing_keys import signed
from camber.road_map.tile_checks import wrong_in_tile
from camber.schemas.road import LAYERS, CloudTile, Layer, LinkTile, Manifest, ReleaseRoot, SurfaceTile

_CLOUD_LAYERS: tuple[Layer, ...] = ("environment_cloud", "road_cloud")

AnyTile = SurfaceTile | LinkTile | CloudTile
Place = tuple[int, int, int]
"""Index of a layer in LAYERS, tile x, tile y."""


class Known(NamedTuple):
    """A blob that is in the folder already: its SHA-256 and its size in bytes."""

    digest: bytes
    size: int


def write_release(
    folder: Path,
    *,
    region: str,
    map_version: int,
    datum: str,
    epoch_year: float,
    time_ns: int,
    surfaces: RoadSurfaces,
    links: RoadLinks,
    clouds: Iterable[CloudTile] = (),
    lineage: Iterable[tuple[int, int]] = (),
    surrogate: str = "",
    previous: ReleaseRoot | None = None,
    signing_key: Ed25519PrivateKey | None = None,
) -> ReleaseRoot:
    """Write a release and return its root. The same arguments give the same bytes, on every machine.

    `lineage`: pairs of a surface here and one of an earlier release that it was split or merged from. `surrogate`: not
    empty where the map was not surveyed, and says how it was made. `time_ns`: when it was made. Whoever reads the
    folder meanwhile sees the old release or the new one. Raises ReleaseError for what cannot be a release and OSError
    where the disk fails; the old release is then still there.
    """
    tiles: list[tuple[Layer, AnyTile]] = [("surfaces", tile) for tile in surface_tiles(surfaces)]
    tiles += [("links", tile) for tile in link_tiles(links)]
    tiles += [(cloud.layer, cloud) for cloud in clouds]
    blobs: dict[Place, bytes] = {}
    for layer, tile in tiles:
        blobs[_place_of(layer, tile, blobs)] = encoded(tile, f"{layer} of tile {tile.x}, {tile.y}")
    known = set(surfaces.surface_id.tolist())
    pairs = sorted(set(lineage))
    missing = {child for child, _ in pairs} - known
    if missing:
        raise ReleaseError("lineage", "surface", "a surface of this release", actual=str(min(missing)))
    heading = Heading(region, map_version, datum, epoch_year, time_ns, surrogate, pairs)
    return seal_release(folder, heading, blobs, previous=previous, signing_key=signing_key)


@dataclass(frozen=True)
class Heading:
    """What a manifest says of a release beside its tiles; names as in Manifest."""

    region: str
    map_version: int
    datum: str
    epoch_year: float
    time_ns: int
    surrogate: str = ""
    lineage: Sequence[tuple[int, int]] = ()
    reference_sha256: str | None = None
    corrections_sha256: str | None = None


def seal_release(
    folder: Path,
    heading: Heading,
    blobs: Mapping[Place, bytes | Known],
    *,
    previous: ReleaseRoot | None,
    signing_key: Ed25519PrivateKey | None,
) -> ReleaseRoot:
    """Write the blobs that are not in the folder yet, then manifest and root; as `write_release`.

    A blob is its bytes, or where it is in the folder already its hash and size.
    """
    region, map_version, time_ns = heading.region, heading.map_version, heading.time_ns
    if previous is not None and (previous.region != region or previous.map_version >= map_version):
        expected = f"region {previous.region} and more than {previous.map_version}"
        raise ReleaseError("release", "region and map_version", expected, actual=f"{region}, {map_version}")
    places = sorted(blobs)
    entries = [_entry(blobs[place]) for place in places]
    try:
        manifest = Manifest(
            time_ns=time_ns,
            region=region,
            map_version=map_version,
            datum=heading.datum,
            epoch_year=heading.epoch_year,
            surrogate=heading.surrogate,
            previous_sha256=None if previous is None else previous.manifest_sha256,
            reference_sha256=heading.reference_sha256,
            corrections_sha256=heading.corrections_sha256,
            tile_x=np.array([x for _, x, _ in places], np.int32),
            tile_y=np.array([y for _, _, y in places], np.int32),
            layer=np.array([layer for layer, _, _ in places], np.uint8),
            sha256=np.frombuffer(b"".join(entry.digest for entry in entries), np.uint8).reshape(-1, 32),
            size_bytes=np.array([entry.size for entry in entries], np.int64),
            lineage_surface_id=np.array([child for child, _ in heading.lineage], np.int64),
            lineage_parent_id=np.array([parent for _, parent in heading.lineage], np.int64),
        )
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        raise ReleaseError("manifest", ".".join(str(part) for part in first["loc"]), first["msg"]) from None
    head = encoded(manifest, "manifest")
    digest = hashlib.sha256(head).hexdigest()
    root = ReleaseRoot(time_ns=time_ns, region=region, map_version=map_version, manifest_sha256=digest)
    root = root if signing_key is None else signed(root, signing_key)
    for place, entry in zip(places, entries, strict=True):
        data = blobs[place]
        if isinstance(data, bytes):
            write_blob(folder, entry.digest.hex(), data)
    write_blob(folder, digest, head)
    # The folders of the blobs may be new: their names must be on the disk before a root counts on them.
    sync_folder(folder / "blobs")
    sync_folder(folder)
    write_file(folder / ROOT_NAME, encoded(root, "root"))
    return root


def _entry(blob: bytes | Known) -> Known:
    return blob if isinstance(blob, Known) else Known(hashlib.sha256(blob).digest(), len(blob))


def _place_of(layer: Layer, tile: AnyTile, blobs: Collection[Place]) -> Place:
    name, place = f"{layer} of tile {tile.x}, {tile.y}", (LAYERS.index(layer), tile.x, tile.y)
    if isinstance(tile, CloudTile) and layer not in _CLOUD_LAYERS:
        raise ReleaseError(name, "layer", " or ".join(_CLOUD_LAYERS), actual=layer)
    if place in blobs:
        raise ReleaseError(name, "tile", "each tile of a layer once")
    wrong = wrong_in_tile(tile)
    if wrong is not None:
        raise ReleaseError(name, *wrong)
    return place
