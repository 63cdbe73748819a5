"""Builds releases of the map: the reference plus the fleet's corrections, signed, with increasing versions.

The releases folder holds all of them: `root.msgpack` is the newest, each manifest names its predecessor, and the
corrections of each are a blob. A roll-back is a new release with the corrections of an old one, because vehicles only
accept increasing versions.
"""

from __future__ import annotations

import fcntl
import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from numpy.typing import NDArray

from camber.map_update.fusion.correction_rows import NONE, Corrections, from_bytes, normalize, to_bytes
from camber.map_update.stores.store import OvertakenError
from camber.road_map.release import ROOT_NAME, BlobSource, Release, ReleaseError, open_release, release_of
from camber.road_map.release_files import ReleaseFolder, decoded, encoded, write_blob
from camber.road_map.release_writer import StoredBlob, TileKey, write_tiles_and_manifest
from camber.road_map.road_columns import rows_of_ids
from camber.road_map.road_tiles import changed_tile, grid_nodes
from camber.road_map.tile_checks import tile_defect
from camber.road_map.tile_grid import Tile
from camber.schemas.road import LAYERS, Manifest, ReleaseRoot, SurfaceTile


class ReleaseRecord(NamedTuple):
    """An earlier release, by its manifest."""

    manifest_sha256: str
    manifest: Manifest


class ReleaseBuilder:
    """Builds the releases of one region in one folder, from one reference.

    Processes that build in the same folder exclude each other. All methods raise ReleaseError for an invalid release
    and OSError if the disk fails; the previous release then stays in force.
    """

    def __init__(self, folder: Path, reference: Release, *, signing_key: Ed25519PrivateKey | None) -> None:
        self.folder = folder
        self.reference = reference
        self._signing_key = signing_key
        self._tiles_of: tuple[NDArray[np.int64], NDArray[np.int64], list[Tile]] | None = None

    def current(self) -> Release | None:
        """Return the newest release in the folder, or None."""
        return open_release(self.folder) if (self.folder / ROOT_NAME).exists() else None

    def versions_of_reference(self) -> set[int]:
        """Return the versions of the map that have exactly the surfaces of the reference."""
        root = self.reference.root
        digest_of = {root.map_version: root.manifest_sha256} | {
            record.manifest.map_version: record.manifest.reference_sha256 or record.manifest_sha256
            for record in history(self.folder)
        }
        return {version for version, digest in digest_of.items() if digest == root.manifest_sha256}

    def corrections(self) -> Corrections:
        """Return the corrections of the newest release."""
        current = self.current()
        return NONE if current is None else corrections_of(current.source, current.manifest)

    def build(
        self, corrections: Corrections, *, time_ns: int, previous: ReleaseRoot | None = None
    ) -> ReleaseRoot:
        """Return the release with these corrections: a new one, unless the newest has the same.

        OvertakenError if `previous`, on which they are based, is given and no longer in force.
        Only tiles with a changed correction get other bytes. The same reference, folder and arguments give the same
        bytes.
        """
        with self._locked():
            current = self.current()
            if previous is not None and (current is None or current.root != previous):
                raise OvertakenError(
                    f"{self.folder}: another release than {previous.map_version} is in force"
                )
            return self._build(corrections, time_ns)

    def roll_back(self, map_version: int, *, time_ns: int) -> ReleaseRoot:
        """Return a new release with the corrections of release `map_version`."""
        with self._locked():
            manifests = {record.manifest.map_version: record.manifest for record in history(self.folder)}
            if map_version not in manifests:
                versions = ", ".join(map(str, manifests))
                raise ReleaseError(str(self.folder), "version", f"one of {versions}", actual=str(map_version))
            return self._build(corrections_of(ReleaseFolder(self.folder), manifests[map_version]), time_ns)

    def _build(self, corrections: Corrections, time_ns: int) -> ReleaseRoot:
        current, reference = self.current(), self.reference
        before = NONE if current is None else corrections_of(current.source, current.manifest)
        previous = reference.root if current is None else current.root
        version = max(previous.map_version, reference.root.map_version) + 1
        rows = normalize(corrections, before, version)
        used = None if current is None else current.manifest.reference_sha256
        same_reference = used == reference.root.manifest_sha256
        if same_reference and current is not None and np.array_equal(rows, before):
            return current.root
        if current is not None and not same_reference:
            self._refuse_reused_ids()
        if not same_reference:
            self._keep_reference()
        blobs = self._kept_blobs()
        blobs |= {(0, *tile): self._corrected(tile, rows) for tile in self._touched(rows)}
        kept = to_bytes(rows, time_ns)
        digest = hashlib.sha256(kept).hexdigest()
        write_blob(self.folder, digest, kept)
        return write_tiles_and_manifest(
            self.folder,
            blobs,
            lineage=self._lineage(current),
            previous=previous,
            signing_key=self._signing_key,
            region=reference.manifest.region,
            map_version=version,
            datum=reference.manifest.datum,
            epoch_year=reference.manifest.epoch_year,
            time_ns=time_ns,
            surrogate=reference.manifest.surrogate,
            reference_sha256=reference.root.manifest_sha256,
            corrections_sha256=digest,
        )

    def _kept_blobs(self) -> dict[TileKey, bytes | StoredBlob]:
        """Return the reference's tiles, which are in the folder already."""
        return {
            (LAYERS.index(layer), x, y): StoredBlob(bytes.fromhex(digest), size)
            for digest, (layer, x, y, size) in self.reference.tiles_by_hash().items()
        }

    def _keep_reference(self) -> None:
        """Copy the reference into the folder, so that the chain of manifests ends at the reference's."""
        source, reference = self.reference.source, self.reference
        if isinstance(source, ReleaseFolder) and source.folder.resolve() == self.folder.resolve():
            return
        digests = {*reference.hashes(), reference.root.manifest_sha256}
        for digest in sorted(digests):
            write_blob(self.folder, digest, source.blob(digest, None))

    def _touched(self, rows: Corrections) -> list[Tile]:
        """Return the tiles that hold a corrected surface; ReleaseError for surfaces not in the reference."""
        if self._tiles_of is None:
            tiles = self.reference.tiles("surfaces")
            ids = [tile.surface_id for xy in tiles if (tile := self.reference.surface_tile(*xy)) is not None]
            number = np.repeat(np.arange(len(ids)), [len(each) for each in ids])
            self._tiles_of = np.concatenate([*ids, np.zeros(0, np.int64)]), number, tiles
        every, number, tiles = self._tiles_of
        unknown = np.setdiff1d(rows["surface_id"], every)
        if len(unknown):
            expected = "a surface of the reference"
            raise ReleaseError("corrections", "surface_id", expected, actual=str(unknown[0]))
        return [tiles[n] for n in np.unique(number[np.isin(every, rows["surface_id"])]).tolist()]

    def _corrected(self, tile: Tile, rows: Corrections) -> bytes:
        original = self.reference.surface_tile(*tile)
        assert original is not None
        changed = corrected_tile(original, rows)
        name = f"surfaces of tile {tile[0]}, {tile[1]}"
        wrong = tile_defect(changed)
        if wrong is not None:
            raise ReleaseError(name, *wrong)
        return encoded(changed, name)

    def _lineage(self, current: Release | None) -> list[tuple[int, int]]:
        """Return the (surface, parent) pairs of the reference and of the previous release."""
        pairs: set[tuple[int, int]] = set()
        for manifest in (self.reference.manifest, *(() if current is None else (current.manifest,))):
            parents = manifest.lineage_parent_id.tolist()
            pairs |= set(zip(manifest.lineage_surface_id.tolist(), parents, strict=True))
        ids = set(surface_ids(self.reference.source, self.reference.manifest).tolist())
        return sorted(pair for pair in pairs if pair[0] in ids)

    def _refuse_reused_ids(self) -> None:
        """Raise ReleaseError if the reference reuses the id of a surface that an earlier release removed."""
        reference_ids = surface_ids(self.reference.source, self.reference.manifest)
        source, newer = ReleaseFolder(self.folder), reference_ids
        removed: set[int] = set()
        # From the newest to the oldest: ids that only the older of two successive releases has were removed.
        manifests = (each.manifest for each in history(self.folder))
        corrected = [manifest for manifest in manifests if manifest.reference_sha256 is not None]
        for number, manifest in enumerate(corrected):
            ids = surface_ids(source, manifest)
            if number:
                removed |= set(np.setdiff1d(ids, newer).tolist())
            removed |= set(np.setdiff1d(manifest.lineage_parent_id, ids).tolist())
            newer = ids
        reused = sorted(removed & set(reference_ids.tolist()))
        if reused:
            name, actual = self.reference.source.name(None), f"{len(reused)}, {reused[0]} first"
            raise ReleaseError(name, "surface_id", "no id of a removed surface", actual=actual)

    @contextmanager
    def _locked(self) -> Iterator[None]:
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / ".making").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield


def corrected_tile(tile: SurfaceTile, rows: Corrections) -> SurfaceTile:
    """Return a tile of the reference with the corrections of its surfaces applied.

    The tile's time is the latest time at which one of its surfaces was observed.
    """
    at = rows_of_ids(rows["surface_id"], tile.surface_id)
    surfaces = np.flatnonzero(at >= 0)
    corrections = rows[at[surfaces]]
    nodes, of_surface = grid_nodes(tile, surfaces)
    seen_ns = tile.last_seen_ns.copy()
    seen_ns[surfaces] = np.maximum(seen_ns[surfaces], corrections["last_seen_ns"])
    return changed_tile(
        tile,
        time_ns=max(tile.time_ns, int(corrections["last_seen_ns"].max(initial=0))),
        raised=(nodes, corrections["offset_m"][of_surface]),
        sigma_m=(surfaces, corrections["sigma_m"]),
        vehicles=(surfaces, corrections["vehicles"]),
        last_seen_ns=(surfaces, seen_ns[surfaces]),
    )


def reference_in(folder: Path) -> Release:
    """Return the reference of the newest release in a releases folder; raises ReleaseError."""
    current = open_release(folder)
    digest = current.manifest.reference_sha256
    if digest is None:
        return current
    source = ReleaseFolder(folder)
    manifest = decoded(Manifest, source.blob(digest, None), source.name(digest))
    root = ReleaseRoot(
        time_ns=manifest.time_ns,
        region=manifest.region,
        map_version=manifest.map_version,
        manifest_sha256=digest,
    )
    return release_of(source, root, source.name(digest))


def history(folder: Path) -> Iterator[ReleaseRecord]:
    """Yield the releases in a folder from the newest back to the reference, as far as manifests exist."""
    if not (folder / ROOT_NAME).exists():
        return
    source = ReleaseFolder(folder)
    root = decoded(ReleaseRoot, source.root(), source.name(None))
    digest: str | None = root.manifest_sha256
    while digest is not None:
        try:
            manifest = decoded(Manifest, source.blob(digest, None), source.name(digest))
        except ReleaseError:
            if digest == root.manifest_sha256:
                raise
            return
        yield ReleaseRecord(digest, manifest)
        digest = manifest.previous_sha256


def corrections_of(source: BlobSource, manifest: Manifest) -> Corrections:
    """Return the corrections of a release whose blobs are in `source`."""
    digest = manifest.corrections_sha256
    return NONE if digest is None else from_bytes(source.blob(digest, None), source.name(digest))


def surface_ids(source: BlobSource, manifest: Manifest) -> NDArray[np.int64]:
    """Return the ids of all surfaces of a release, each once, ascending."""
    ids = [np.zeros(0, np.int64)]
    for row in np.flatnonzero(manifest.layer == LAYERS.index("surfaces")).tolist():
        digest = manifest.sha256[row].tobytes().hex()
        ids.append(decoded(SurfaceTile, source.blob(digest, None), source.name(digest)).surface_id)
    return np.unique(np.concatenate(ids))
