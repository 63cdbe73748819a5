"""Follow the active release of a folder or a store."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from camber.road_map.release import BlobSource, Release, ReleaseError, ReleaseFolder, open_release
from camber.road_map.signing_keys import TrustedKey


class ReleaseWatch:
    """Detects a new root, verifies the new tiles of its release incrementally, then makes the release current.

    `current` is the release to use, None before the first. `problem` is why the release of the source is not used, None
    if it is used or being verified. `acceptable` may refuse a release by raising ReleaseError.
    """

    def __init__(
        self,
        source: Path | BlobSource,
        *,
        public_key: TrustedKey | None = None,
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
        """Whether a release is being verified."""
        return self._pending is not None

    def look(self) -> None:
        """Start to verify the release if the root's stamp has changed."""
        stamp = self._source.stamp()
        if stamp is not None and stamp == self._seen:
            return
        # Taken before the root is read: a change in between shows as another stamp the next time.
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
        """Verify about `max_bytes` more (at least one tile); True once the new release is current."""
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
        """Treat the root as changed at the next look: missing blobs may have arrived."""
        self._seen = None
