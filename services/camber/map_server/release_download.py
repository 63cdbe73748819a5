"""Brings releases into the vehicle's store: asks for the newest root, then for the blobs that are not here yet.

Nothing that comes is believed: a root by its signature and version, a blob by its hash, a tile by what a map can be.
Whoever gives the bytes, the cloud over the bus or a folder, is asked the same questions. A fetch that is cut off goes
on where it was.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from numpy.typing import NDArray

from camber.road_map.blob_delta import unpacked
from camber.road_map.release import Release, ReleaseError, checked_tile
from camber.road_map.release_files import MAX_BLOB_BYTES, PART_BYTES, BlobMissing, ReleaseFolder
from camber.road_map.release_server import ReleaseServing
from camber.road_map.store import Kept, MapStore
from camber.road_map.tile_grid import TILES, Tile, tile_of, tiles_around
from camber.schemas.base import EARLIEST_NS
from camber.schemas.codec import DecodeError, decode
from camber.schemas.fleet import MapBlobReply, MapBlobRequest, MapRootReply, MapRootRequest
from camber.schemas.road import LAYERS, CloudTile, Layer, LinkTile, Manifest, ReleaseRoot, SurfaceTile

Integers = NDArray[np.int64]

_MORE = 32
"""Blobs that are asked for along with another."""
_KEPT_FACTOR = 2.0
"""Tiles stay in the store until they are this many times as far away as those that are fetched."""


class NoAnswer(RuntimeError):  # noqa: N818 (the name says what is the matter)
    """Whoever was asked for a release does not answer now."""


class Supplier(Protocol):
    """Who has releases; both methods raise NoAnswer where there is no reply."""

    name: str
    may_be_old: bool
    """A release older than one that was here before is nothing to speak of: a folder from the factory."""

    def region(self) -> str | None:
        """The region it has releases of, where it has only one."""

    def root(self, request: MapRootRequest) -> MapRootReply:
        """The newest root of a region."""

    def blob(self, request: MapBlobRequest) -> MapBlobReply:
        """A part of a packed blob."""


@dataclass(frozen=True)
class Wishes:
    """What is to be fetched. `around_m` None: all of the map; else what comes within it of the vehicle."""

    region: str | None
    public_key: Ed25519PublicKey | None
    around_m: float | None
    acceptable: Callable[[Release], None] = lambda release: None
    """Raises ReleaseError for a release that is not to be used here."""


@dataclass
class Where:
    """Where the vehicle is, by the questions it asks; None: nobody has asked yet."""

    point_rad: tuple[float, float] | None = None


class FolderSupplier:
    """A folder of releases, from the factory or on a stick."""

    may_be_old = True

    def __init__(self, folder: Path) -> None:
        self.name = str(folder)
        self._serving = ReleaseServing(folder, near=True)
        self._folder = ReleaseFolder(folder)

    def stamp(self) -> object | None:
        """Another one after the folder's root has changed."""
        return self._folder.stamp()

    def region(self) -> str | None:
        """That of the folder's release."""
        try:
            return self._serving.head(time_ns=EARLIEST_NS).region
        except ReleaseError:
            return None

    def root(self, request: MapRootRequest) -> MapRootReply:
        """The folder's root."""
        return self._serving.root(request, time_ns=request.time_ns)

    def blob(self, request: MapBlobRequest) -> MapBlobReply:
        """A part of one of the folder's blobs."""
        return self._serving.blob(request, time_ns=request.time_ns)


class Fetching:
    """Fetches step by step. `in_use` is the version that a reader of the store has open."""

    def __init__(self, store: MapStore, wishes: Wishes, where: Where, *, now_ns: Callable[[], int]) -> None:
        self.fetched_bytes = 0
        self.fetched_blobs = 0
        self.in_use: int | None = None
        self._store = store
        self._wishes = wishes
        self._where = where
        self._now_ns = now_ns
        self._ahead: dict[tuple[str, str | None], bytes] = {}

    def ask(self, supplier: Supplier) -> bool:
        """Ask for the newest root; True where its release is new. NoAnswer; ReleaseError for one that is refused."""
        newest = self._store.coming() or self._store.current()
        region = self._wishes.region or (supplier.region() if newest is None else newest.region)
        if region is None:
            raise ReleaseError(supplier.name, "region", "a setting, where there is no map yet")
        have = (
            None if newest is None or newest.map_version != self._store.highest() else newest.manifest_sha256
        )
        reply = supplier.root(MapRootRequest(time_ns=self._now_ns(), region=region, have_sha256=have))
        if reply.status != "known":
            return False
        data = reply.payload.tobytes()
        if supplier.may_be_old and self._is_old(data):
            return False
        return self._store.accept(data, file=supplier.name, region=region, public_key=self._wishes.public_key)

    def fetch(self, supplier: Supplier) -> Iterator[None]:
        """Fetch what is wanted, a step for each blob; a new release is in force when all of it is here.

        Ends when nothing is missing. NoAnswer, StoreFull, and ReleaseError for what is refused: the release in force
        stays. It may be left at any step.
        """
        coming = self._store.coming()
        for kept in (coming, self._store.current()) if coming is not None else (self._store.current(),):
            if kept is None:
                return
            yield from self._manifest(kept, supplier)
            release = self._store.open(kept.map_version)
            self._wishes.acceptable(release)
            yield from self._tiles(release, supplier)
            if kept == coming:
                self._store.put_in_force(kept.map_version)
                yield
            coming = None
        self._store.collect(() if self.in_use is None else (self.in_use,), self._kept_tiles())

    def drop_damaged(self) -> None:
        """Forget the blobs of the release in force that are not as they were written; they are fetched again."""
        kept, current = self._store.current(), self._current()
        digests = set() if current is None else set(current.hashes())
        for digest in digests | ({kept.manifest_sha256} if kept is not None else set()):
            try:
                self._store.blob(digest, None)
            except BlobMissing:
                pass
            except ReleaseError:
                self._store.drop(digest)

    def _is_old(self, root: bytes) -> bool:
        try:
            version = decode(ReleaseRoot, root).message.map_version
        except DecodeError:
            return False
        return version < (self._store.highest() or 0)

    def lacks(self) -> bool:
        """Is something wanted that is not here?"""
        if self._store.coming() is not None:
            return True
        current = self._current()
        return current is not None and bool(self._store.missing(self._wanted(current)))

    def _manifest(self, kept: Kept, supplier: Supplier) -> Iterator[None]:
        if self._store.missing([kept.manifest_sha256]):
            current = self._store.current()
            base = None if current is None else current.manifest_sha256
            self._store.put(kept.manifest_sha256, self._blob(supplier, kept.manifest_sha256, None, base))
            yield

    def _tiles(self, release: Release, supplier: Supplier) -> Iterator[None]:
        """Until nothing is missing of what is wanted, which may become more while the vehicle drives."""
        manifest, before = release.manifest, self._current()
        rows = {manifest.sha256[row].tobytes().hex(): row for row in range(len(manifest.layer))}
        while missing := self._store.missing(self._wanted(release)):
            begun_at = self.tile()
            names = [_name(manifest, rows[digest]) for digest in missing]
            bases = [None if before is None else before.sha256(*name) for name in names]
            wanted = list(zip(missing, bases, strict=True))
            for n, ((digest, base), (layer, x, y)) in enumerate(zip(wanted, names, strict=True)):
                size = int(manifest.size_bytes[rows[digest]])
                data = self._blob(supplier, digest, size, base, wanted[n + 1 : n + 1 + _MORE])
                _check(data, f"{supplier.name}: blob {digest}", layer, x, y)
                self._store.put(digest, data)
                yield
                if self.tile() != begun_at:  # other tiles are nearer now
                    break

    def tile(self) -> Tile | None:
        """The tile that the vehicle is in, as far as is known."""
        point = self._where.point_rad
        return None if point is None else tile_of(*point)

    def _blob(
        self,
        supplier: Supplier,
        digest: str,
        size: int | None,
        base_digest: str | None,
        more: Sequence[tuple[str, str | None]] = (),
    ) -> bytes:
        """A blob, verified: against one that is here, where that does not lead to it as a whole.

        `more`: what is wanted next, (hash, base); what of it comes along waits in `_ahead`.
        """
        limit = MAX_BLOB_BYTES if size is None else min(size, MAX_BLOB_BYTES)
        for base_name in dict.fromkeys((base_digest, None)):
            base = self._base(base_name)
            if base_name is not None and base is None:
                continue
            data = self._ahead.pop((digest, base_name), None)
            if data is None:
                data = self._parts(supplier, digest, base_name, limit, more)
            try:
                blob = unpacked(data, base, limit=limit)
            except ReleaseError as error:
                self._store.drop(digest)
                refusal = error
            else:
                if hashlib.sha256(blob).hexdigest() == digest:
                    self.fetched_blobs += 1
                    return blob
                self._store.drop(digest)
                refusal = ReleaseError(supplier.name, "SHA-256 of the bytes", f"blob {digest}")
        raise refusal

    def _base(self, digest: str | None) -> bytes | None:
        try:
            return None if digest is None else self._store.blob(digest, None)
        except ReleaseError:
            return None

    def _parts(
        self,
        supplier: Supplier,
        digest: str,
        base: str | None,
        limit: int,
        more: Sequence[tuple[str, str | None]],
    ) -> bytes:
        parts, count = self._store.parts(digest, base), None
        if not parts:
            self._store.drop(digest)  # parts against another base
        most = -(-(limit + limit // 100 + 1024) // PART_BYTES) + 1  # packing never adds more
        while count is None or len(parts) < count:
            lacking = set(self._store.missing([of for _, of in more if of is not None]))
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
                raise NoAnswer(f"{supplier.name}: blob {digest}: {reply.reason}")
            if not 0 < reply.parts <= most:
                raise ReleaseError(
                    supplier.name, f"parts of blob {digest}", f"1 to {most}", actual=str(reply.parts)
                )
            count = reply.parts
            parts.append(reply.payload.tobytes())
            self.fetched_bytes += len(parts[-1])
            self._keep_ahead(supplier, request, reply)
            if count > 1 and len(parts) < count:
                self._store.put_part(digest, base, len(parts) - 1, parts[-1])
        return b"".join(parts)

    def _keep_ahead(self, supplier: Supplier, request: MapBlobRequest, reply: MapBlobReply) -> None:
        """What has come of the blobs wanted next; of the reply before nothing is left."""
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
        kept = self._store.current()
        try:
            return None if kept is None else self._store.open(kept.map_version)
        except ReleaseError:
            return None

    def _wanted(self, release: Release) -> list[str]:
        """Hashes of the tiles that must be here, in the order in which they are wanted."""
        manifest, around_m = release.manifest, self._wishes.around_m
        point = self._where.point_rad
        x, y = manifest.tile_x.astype(np.int64), manifest.tile_y.astype(np.int64)
        if around_m is None:
            chosen = np.ones(len(x), bool)
        else:
            near = set() if point is None else set(tiles_around(*point, around_m))
            chosen = _among(x, y, near | self._places_here(release))
        rows = np.flatnonzero(chosen)
        if point is not None:
            rows = rows[np.argsort(_steps_from(point, x[rows], y[rows]), kind="stable")]
        return [manifest.sha256[row].tobytes().hex() for row in rows.tolist()]

    def _places_here(self, release: Release) -> set[Tile]:
        """The tiles that the release in force has here: a newer one must not know less."""
        current = self._current()
        if current is None or current.root == release.root:
            return set()
        manifest = current.manifest
        digests = [row.tobytes().hex() for row in manifest.sha256]
        missing = set(self._store.missing(digests))
        places = zip(digests, manifest.tile_x.tolist(), manifest.tile_y.tolist(), strict=True)
        return {(x, y) for digest, x, y in places if digest not in missing}

    def _kept_tiles(self) -> Callable[[Release], set[str]] | None:
        around_m, point = self._wishes.around_m, self._where.point_rad
        if around_m is None or point is None:
            return None
        near = set(tiles_around(*point, _KEPT_FACTOR * around_m))

        def keep(release: Release) -> set[str]:
            manifest = release.manifest
            chosen = _among(manifest.tile_x.astype(np.int64), manifest.tile_y.astype(np.int64), near)
            return {manifest.sha256[row].tobytes().hex() for row in np.flatnonzero(chosen).tolist()}

        return keep


def _name(manifest: Manifest, row: int) -> tuple[Layer, int, int]:
    return LAYERS[manifest.layer[row]], int(manifest.tile_x[row]), int(manifest.tile_y[row])


def _check(data: bytes, file: str, layer: Layer, x: int, y: int) -> None:
    """Raise ReleaseError unless these bytes are a tile of a map, this one."""
    match layer:
        case "surfaces":
            checked_tile(SurfaceTile, data, file, layer, x, y)
        case "links":
            checked_tile(LinkTile, data, file, layer, x, y)
        case _:
            checked_tile(CloudTile, data, file, layer, x, y)


def _among(x: Integers, y: Integers, tiles: set[Tile]) -> NDArray[np.bool_]:
    return np.isin(x * TILES + y, np.array([a * TILES + b for a, b in tiles], np.int64))


def _steps_from(point: tuple[float, float], x: Integers, y: Integers) -> Integers:
    """How many tiles away, the short way round the earth."""
    here = tile_of(*point)
    if here is None:
        return np.zeros(len(x), np.int64)
    east = np.abs(x - here[0])
    steps: Integers = np.maximum(np.minimum(east, TILES - east), np.abs(y - here[1]))
    return steps
