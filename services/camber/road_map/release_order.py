"""Versions of the map go one way: an older release, signed as it may be, takes the place of none."""

from __future__ import annotations

from camber.road_map.road_columns import ReleaseError
from camber.schemas.base import Count, Model, Name, Sha256
from camber.schemas.road import ReleaseRoot


class AcceptedRelease(Model):
    """The newest release that was ever in use."""

    region: Name
    map_version: Count
    manifest_sha256: Sha256


def check_order(
    root: ReleaseRoot, file: str, *, region: str | None, highest: int | None, manifest_sha256: str | None
) -> None:
    """Raise ReleaseError for a root of another region, below the highest version, or not the same of its version.

    `manifest_sha256`: of the release that was accepted with the root's version; each None: nothing to compare with.
    """
    if region is not None and root.region != region:
        raise ReleaseError(file, "region", region, actual=root.region)
    if highest is not None and root.map_version < highest:
        newest = f"{highest} or more, which has been here already"
        raise ReleaseError(file, "map_version", newest, actual=str(root.map_version))
    if manifest_sha256 is not None and root.manifest_sha256 != manifest_sha256:
        expected = f"the manifest of version {root.map_version} that was accepted before"
        raise ReleaseError(file, "manifest_sha256", expected, actual=root.manifest_sha256)
