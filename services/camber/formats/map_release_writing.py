"""Write a release of the map."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable
from pathlib import Path

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from pydantic import ValidationError

from camber.formats.map_release_files import ROOT_NAME, encoded, sync_folder, write_blob, write_file
from camber.formats.map_release_keys import signed
from camber.formats.map_road_tiles import link_tiles, surface_tiles
from camber.formats.map_roads import ReleaseError, RoadLinks, RoadSurfaces
from camber.formats.map_tile_checks import wrong_in_tile
from camber.schemas.road import LAYERS, CloudTile, Layer, LinkTile, Manifest, ReleaseRoot, SurfaceTile

_CLOUD_LAYERS: tuple[Layer, ...] = ("environment_cloud", "road_cloud")

AnyTile = SurfaceTile | LinkTile | CloudTile


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
    blobs: dict[tuple[int, int, int], bytes] = {}
    for layer, tile in tiles:
        blobs[_place_of(layer, tile, blobs)] = encoded(tile, f"{layer} of tile {tile.x}, {tile.y}")
    pairs = _pairs(lineage, surfaces)
    if previous is not None and (previous.region != region or previous.map_version >= map_version):
        expected = f"region {previous.region} and more than {previous.map_version}"
        raise ReleaseError("release", "region and map_version", expected, found=f"{region}, {map_version}")
    places = sorted(blobs)
    digests = [hashlib.sha256(blobs[place]).digest() for place in places]
    try:
        manifest = Manifest(
            time_ns=time_ns,
            region=region,
            map_version=map_version,
            datum=datum,
            epoch_year=epoch_year,
            surrogate=surrogate,
            previous_sha256=None if previous is None else previous.manifest_sha256,
            tile_x=np.array([x for _, x, _ in places], np.int32),
            tile_y=np.array([y for _, _, y in places], np.int32),
            layer=np.array([layer for layer, _, _ in places], np.uint8),
            sha256=np.frombuffer(b"".join(digests), np.uint8).reshape(-1, 32),
            size_bytes=np.array([len(blobs[place]) for place in places], np.int64),
            lineage_surface_id=np.array([child for child, _ in pairs], np.int64),
            lineage_parent_id=np.array([parent for _, parent in pairs], np.int64),
        )
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        raise ReleaseError("manifest", ".".join(str(part) for part in first["loc"]), first["msg"]) from None
    head = encoded(manifest, "manifest")
    digest = hashlib.sha256(head).hexdigest()
    root = ReleaseRoot(time_ns=time_ns, region=region, map_version=map_version, manifest_sha256=digest)
    root = root if signing_key is None else signed(root, signing_key)
    for name, data in zip(digests, (blobs[place] for place in places), strict=True):
        write_blob(folder, name.hex(), data)
    write_blob(folder, digest, head)
    # The folders of the blobs may be new: their names must be on the disk before a root counts on them.
    sync_folder(folder / "blobs")
    sync_folder(folder)
    write_file(folder / ROOT_NAME, encoded(root, "root"))
    return root


def _place_of(layer: Layer, tile: AnyTile, blobs: Collection[tuple[int, int, int]]) -> tuple[int, int, int]:
    name, place = f"{layer} of tile {tile.x}, {tile.y}", (LAYERS.index(layer), tile.x, tile.y)
    if isinstance(tile, CloudTile) and layer not in _CLOUD_LAYERS:
        raise ReleaseError(name, "layer", " or ".join(_CLOUD_LAYERS), found=layer)
    if place in blobs:
        raise ReleaseError(name, "tile", "each tile of a layer once")
    wrong = wrong_in_tile(tile)
    if wrong is not None:
        raise ReleaseError(name, *wrong)
    return place


def _pairs(lineage: Iterable[tuple[int, int]], surfaces: RoadSurfaces) -> list[tuple[int, int]]:
    pairs = sorted(set(lineage))
    missing = {child for child, _ in pairs} - set(surfaces.surface_id.tolist())
    if missing:
        raise ReleaseError("lineage", "surface", "a surface of this release", found=str(min(missing)))
    return pairs
