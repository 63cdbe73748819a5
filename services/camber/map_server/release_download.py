"""Download releases into the vehicle's store: request the newest root, then the blobs that are missing.

All data are untrusted input: a root is verified by signature and version, a blob by its hash, a tile by its contents.
The supplier, map_update over the bus or a folder, answers the same queries. An interrupted download resumes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from camber.road_map.blob_delta import decompress_blob
from camber.road_map.release import Release, ReleaseError, ReleaseTile, decode_tile
from camber.road_map.release_files import MAX_BLOB_BYTES, PART_BYTES, BlobMissingError
from camber.road_map.release_server import ReleaseServer
from camber.road_map.signing_keys import TrustedKey
from camber.road_map.store import MapStore, StoredRelease
from camber.road_map.tile_grid import TILES, Tile, tile_of, tiles_around
from camber.schemas.base import EARLIEST_NS
from camber.schemas.fleet import MapBlobReply, MapBlobRequest, MapRootReply, MapRootRequest

_MORE = 32  # chosen: blobs requested along with another; as many as fit into 256 kB are returned
_KEPT_FACTOR = 2.0
"""Chosen: tiles are deleted beyond this multiple of the download radius, so that none alternates."""

_BlobName = tuple[str, str | None]
"""SHA-256 of a blob and of the blob that it is compressed against, None for none."""


class SupplierUnavailableError(RuntimeError):
    """The supplier of releases does not answer now."""


class ReleaseSupplier(Protocol):
    """Supplier of releases; both queries raise SupplierUnavailableError without a reply."""

    name: str
    may_be_old: bool
    """Whether an older release than before is ignored without an error, as in a folder from the factory."""

    def region(self) -> str | None:
        """Return the region of its releases, if it has only one."""

    def root(self, request: MapRootRequest) -> MapRootReply:
        """Return the newest root of a region."""

    def blob(self, request: MapBlobRequest) -> MapBlobReply:
        """Return a part of a compressed blob."""


class FolderSupplier(ReleaseServer):
    """A folder of releases, from the factory or on a USB stick."""

    may_be_old = True

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, compress=False)
        self.name = str(folder)

    def region(self) -> str | None:
        """Return the region of the folder's release."""
        try:
            return self.head(time_ns=EARLIEST_NS).region
        except ReleaseError:
            return None


class ReleaseDownload:
    """Stepwise download into a store.

    `around_m`: radius around the vehicle of what is downloaded; None: the whole map. `acceptable` raises ReleaseError
    for a release that must not be used here.
    """

    def __init__(
        self,
        store: MapStore,
        *,
        region: str | None,
        public_key: TrustedKey | None,
        around_m: float | None,
        now_ns: Callable[[], int],
        acceptable: Callable[[Release], None] = lambda release: None,
    ) -> None:
        self.store = store
        self.position_rad: tuple[float, float] | None = None
        """Latitude and longitude of the vehicle, from its elevation requests; None before the first."""
        self.in_use: int | None = None
        """Version that a reader of the store has open."""
        self.fetched_bytes = self.fetched_blobs = 0
        self._region, self._public_key, self._around_m = region, public_key, around_m
        self._now_ns, self._acceptable = now_ns, acceptable
        self._ahead: dict[_BlobName, bytes] = {}

    def ask(self, supplier: ReleaseSupplier) -> bool:
        """Request the newest root; True if its release is new.

        Raises SupplierUnavailableError, and ReleaseError for a root that is refused.
        """
        newest = self.store.coming() or self.store.current()
        region = self._region or (supplier.region() if newest is None else newest.region)
        if region is None:
            raise ReleaseError(supplier.name, "region", "a setting, where there is no map yet")
        is_newest = newest is not None and newest.map_version == self.store.highest()
        have = newest.manifest_sha256 if newest is not None and is_newest else None
        reply = supplier.root(MapRootRequest(time_ns=self._now_ns(), region=region, have_sha256=have))
        if reply.status != "known":
            return False
        return self.store.accept(
            reply.payload.tobytes(),
            file=supplier.name,
            region=region,
            public_key=self._public_key,
            may_be_old=supplier.may_be_old,
        )

    def fetch(self, supplier: ReleaseSupplier) -> Iterator[None]:
        """Download what is missing, a step for each blob, then activate the new release.

        Raises SupplierUnavailableError, StoreFullError, and ReleaseError for what is refused; the active release
        remains. The iteration may be abandoned at any step.
        """
        coming = self.store.coming()
        for kept in (coming, self.store.current()) if coming is not None else (self.store.current(),):
            if kept is None:
                return
            yield from self._manifest(kept, supplier)
            release = self.store.open(kept.map_version)
            self._acceptable(release)
            yield from self._tiles(release, supplier)
            if kept == coming:
                self.store.put_in_force(kept.map_version)
                yield
            coming = None
        self.store.collect(() if self.in_use is None else (self.in_use,), self._kept_tiles())

    def drop_damaged(self) -> None:
        """Delete the damaged blobs of the active release, so that they are downloaded again."""
        kept, current = self.store.current(), self._current()
        digests = set() if current is None else set(current.hashes())
        for digest in digests | ({kept.manifest_sha256} if kept is not None else set()):
            try:
                self.store.blob(digest, None)
            except BlobMissingError:
                pass
            except ReleaseError:
                self.store.drop(digest)

    def _manifest(self, kept: StoredRelease, supplier: ReleaseSupplier) -> Iterator[None]:
        if self.store.missing([kept.manifest_sha256]):
            current = self.store.current()
            base = None if current is None else current.manifest_sha256
            self.store.put(kept.manifest_sha256, self._blob(supplier, (kept.manifest_sha256, base)))
            yield

    def _tiles(self, release: Release, supplier: ReleaseSupplier) -> Iterator[None]:
        """Download tiles until none is missing; the selection changes while the vehicle drives."""
        before, tiles = self._current(), release.tiles_by_hash()
        while missing := self.store.missing(self._wanted(release)):
            start_tile = self.tile()
            bases = [None if before is None else before.sha256(*tiles[digest][:3]) for digest in missing]
            wanted = list(zip(missing, bases, strict=True))
            for n, blob in enumerate(wanted):
                digest, (layer, x, y, size) = blob[0], tiles[blob[0]]
                more = wanted[n + 1 : n + 1 + _MORE]
                data = self._blob(supplier, blob, limit=min(size, MAX_BLOB_BYTES), more=more)
                decode_tile(layer, data, file=f"{supplier.name}: blob {digest}", tile=(x, y))
                self.store.put(digest, data)
                yield
                if self.tile() != start_tile:  # other tiles are nearer now
                    break

    def tile(self) -> Tile | None:
        """Return the tile of the vehicle, None if unknown."""
        return None if self.position_rad is None else tile_of(*self.position_rad)

    def _blob(
        self,
        supplier: ReleaseSupplier,
        blob_name: _BlobName,
        *,
        limit: int = MAX_BLOB_BYTES,
        more: Sequence[_BlobName] = (),
    ) -> bytes:
        """Download and verify a blob, first as a difference, then as a whole.

        `more`: blobs needed next; those that arrive along are kept in `_ahead`.
        """
        digest = blob_name[0]
        for base_digest in dict.fromkeys((blob_name[1], None)):
            base = self._base(base_digest)
            if base_digest is not None and base is None:
                continue
            data = self._ahead.pop((digest, base_digest), None)
            if data is None:
                data = self._parts(supplier, (digest, base_digest), limit=limit, more=more)
            try:
                blob = decompress_blob(data, base, limit=limit)
            except ReleaseError as error:
                self.store.drop(digest)
                refusal = error
            else:
                if hashlib.sha256(blob).hexdigest() == digest:
                    self.fetched_blobs += 1
                    return blob
                self.store.drop(digest)
                refusal = ReleaseError(supplier.name, "SHA-256 of the bytes", f"blob {digest}")
        raise refusal

    def _base(self, digest: str | None) -> bytes | None:
        try:
            return None if digest is None else self.store.blob(digest, None)
        except ReleaseError:
            return None

    def _parts(
        self, supplier: ReleaseSupplier, blob_name: _BlobName, *, limit: int, more: Sequence[_BlobName]
    ) -> bytes:
        digest, base = blob_name
        parts, count = self.store.parts(digest, base), None
        if not parts:
            self.store.drop(digest)  # parts against another base
        most = -(-(limit + limit // 100 + 1024) // PART_BYTES) + 1  # compression never adds more
        while count is None or len(parts) < count:
            lacking = set(self.store.missing([of for _, of in more if of is not None]))
            request = MapBlobRequest(
                time_ns=self._now_ns(),
                sha256=digest,
                base_sha256=base,
                part=len(parts),
                more_sha256=tuple(name for name, _ in more),
                more_base_sha256=tuple(None if of is None or of in lacking else of for _, of in more),
            )
            reply = supplier.blob(request)
            if reply.status != "known":
                raise SupplierUnavailableError(f"{supplier.name}: blob {digest}: {reply.reason}")
            if not 0 < reply.parts <= most:
                raise ReleaseError(
                    supplier.name, f"parts of blob {digest}", f"1 to {most}", actual=str(reply.parts)
                )
            count = reply.parts
            parts.append(reply.payload.tobytes())
            self.fetched_bytes += len(parts[-1])
            self._keep_ahead(supplier, request, reply)
            if count > 1 and len(parts) < count:
                self.store.put_part(digest, base, len(parts) - 1, parts[-1])
        return b"".join(parts)

    def _keep_ahead(self, supplier: ReleaseSupplier, request: MapBlobRequest, reply: MapBlobReply) -> None:
        """Keep the further blobs of a reply, in place of those of the reply before."""
        sizes, data = reply.more_bytes.tolist(), reply.more_payload.tobytes()
        names = list(zip(request.more_sha256, request.more_base_sha256, strict=True))
        if len(sizes) > len(names) or any(size <= 0 for size in sizes) or sum(sizes) != len(data):
            expected = f"at most {len(names)} that fill {len(data)} bytes"
            raise ReleaseError(supplier.name, "sizes of more blobs", expected, actual=str(sizes)[:100])
        ends = np.cumsum(sizes, dtype=np.int64).tolist()
        self._ahead = {
            name: data[end - size : end] for name, size, end in zip(names, sizes, ends, strict=False)
        }
        self.fetched_bytes += len(data)

    def _current(self) -> Release | None:
        kept = self.store.current()
        try:
            return None if kept is None else self.store.open(kept.map_version)
        except ReleaseError:
            return None

    def _wanted(self, release: Release) -> list[str]:
        """Return the hashes of the required tiles, nearest first."""
        wanted = release.tiles_by_hash()
        if self._around_m is not None:
            near = self._tiles_within(self._around_m) | self._downloaded_tiles(release)
            wanted = {digest: tile for digest, tile in wanted.items() if (tile.x, tile.y) in near}
        centre = self.tile()
        if centre is None:
            return list(wanted)
        return sorted(wanted, key=lambda digest: _steps(centre, wanted[digest]))

    def _tiles_within(self, radius_m: float) -> set[Tile]:
        return set() if self.position_rad is None else set(tiles_around(*self.position_rad, radius_m))

    def _downloaded_tiles(self, release: Release) -> set[Tile]:
        """Return the tiles downloaded of the active release: a newer one must have them too."""
        current = self._current()
        if current is None or current.root == release.root:
            return set()
        tiles = current.tiles_by_hash()
        missing = set(self.store.missing(tiles))
        return {(tile.x, tile.y) for digest, tile in tiles.items() if digest not in missing}

    def _kept_tiles(self) -> Callable[[Release], set[str]] | None:
        if self._around_m is None or self.position_rad is None:
            return None
        near = self._tiles_within(_KEPT_FACTOR * self._around_m)
        return lambda release: {
            digest for digest, tile in release.tiles_by_hash().items() if (tile.x, tile.y) in near
        }


def _steps(centre: Tile, tile: ReleaseTile) -> int:
    """Return the distance in tiles, in the shorter direction around the earth."""
    east = abs(tile.x - centre[0])
    return max(min(east, TILES - east), abs(tile.y - centre[1]))
