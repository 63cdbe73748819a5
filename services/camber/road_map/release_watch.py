"""The release that a folder or a store holds in force, followed while it is in use."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from camber.road_map.release import BlobSource, Release, ReleaseError, ReleaseFolder, open_release


class ReleaseWatch:
    """Notices a new root, verifies what is new of its release piece by piece, and only then puts it in place.

    `current` is the release to use, None while there was none. `problem` says why what the source holds now is not in
    use; None: it is, or it is being verified. `acceptable` may refuse a release by raising ReleaseError.
    """

    def __init__(
        self,
        source: Path | BlobSource,
        *,
        public_key: Ed25519PublicKey | None = None,
        acceptable: Callable[[Release], None] = lambda release: None,
    ) -> None:
        self.current: Release | None = None
        self.problem: ReleaseError | None = None
        self._source: BlobSource = ReleaseFolder(source) if isinstance(source, Path) else source
        self._public_key = public_key
        self._acceptable = acceptable
        self._seen: object | None = None
        self._pending: tuple[Release, Iterator[int]] | None = None

    @property
    def busy(self) -> bool:
        """Is a release being verified?"""
        return self._pending is not None

    def look(self) -> None:
        """Where the root's stamp is another than the last time, begin to verify its release."""
        stamp = self._source.stamp()
        if stamp is not None and stamp == self._seen:
            return
        # The stamp is taken before the root is read: a change in between shows as another stamp the next time.
        self._seen = stamp
        self._pending = None
        try:
            release = open_release(self._source, public_key=self._public_key)
            self._acceptable(release)
        except ReleaseError as error:
            self.problem = error
            return
        self.problem = None
        if self.current is not None and release.root == self.current.root:
            return
        known = frozenset() if self.current is None else self.current.hashes()
        self._pending = (release, release.check(known))

    def verify(self, max_bytes: float) -> bool:
        """Go on verifying for about `max_bytes` (at least one tile); True where a new release is now in place."""
        if self._pending is None:
            return False
        release, sizes = self._pending
        try:
            while max_bytes > 0:
                size = next(sizes, None)
                if size is None:
                    self.current, self._pending = release, None
                    return True
                max_bytes -= size
        except ReleaseError as error:
            self.problem, self._pending = error, None
        return False

    def forget(self) -> None:
        """Take the root for changed at the next look: its blobs may have come meanwhile."""
        self._seen = None
