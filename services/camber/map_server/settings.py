"""Settings of the map server."""

from __future__ import annotations

from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import ClassVar, Self

from pydantic import Field, field_validator, model_validator

from camber.road_map.release import ReleaseError, load_public_key
from camber.road_map.signing_keys import DatedKey, KeyRotation, TrustedKey
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Name


class MapServerSettings(ServiceSettings):
    """Serves road elevation, links and tiles from a release of the map."""

    SERVICE: ClassVar[str] = "map_server"

    release: Path | None = Field(
        None,
        description="folder of a release, which may appear later: served, or imported into `store` if that is set. "
        "Versions only increase, in one region; `release.json` in `state_dir` keeps the newest over restarts, to go "
        "back it is deleted while the service is stopped",
    )
    public_key: Path | None = Field(
        None,
        description="PEM file of the Ed25519 key that releases must be signed with; unset: signatures of "
        "`release` are not checked, and releases from the bus are refused",
    )
    public_key_last_day: date | None = Field(
        None, description="last day (UTC) on which `public_key` is accepted; unset: no limit"
    )
    next_public_key: Path | None = Field(
        None,
        description="PEM file of the key that follows `public_key`; while both are valid, releases may be signed with "
        "either",
    )
    next_public_key_first_day: date | None = Field(
        None, description="first day (UTC) on which `next_public_key` is accepted; unset: at once"
    )
    datum: Name = Field("WGS84", description="datum of positions and heights")
    max_age_days: float | None = Field(
        None, gt=0.0, description="an older release is stale and all roads are unknown; unset: no limit"
    )
    look_every_s: float = Field(
        2.0, gt=0.0, le=3600.0, description="interval of checks for a new release on disk"
    )
    retry_every_s: float = Field(60.0, gt=0.0, description="interval of retries of a refused release")
    verify_bytes: int = Field(
        4_000_000,
        gt=0,
        description="approximate amount of a new release that is verified per iteration of the work loop",
    )
    tiles_kept: int = Field(256, ge=32, description="number of tiles in memory")
    store: Path | None = Field(
        None,
        description="file for the vehicle's releases, downloaded from the cloud; unset: `release` is served",
    )
    region: Name | None = Field(None, description="region of the releases; unset: that of the present map")
    around_km: float | None = Field(
        None,
        gt=0.5,
        le=1000.0,
        description="radius around the vehicle of the map to download; unset: the whole map",
    )
    ask_every_s: float = Field(
        600.0, ge=0.1, description="longest interval of queries to the cloud for a newer release"
    )
    ask_spread_s: float = Field(
        10.0,
        ge=0.0,
        description="longest random delay of a query after a notice, which a whole fleet receives at once",
    )
    store_limit_bytes: int = Field(4 << 30, ge=1 << 20, description="largest size of `store`")
    unsigned: bool = Field(
        False,
        description="accept releases from the bus without a `public_key`, from any publisher; for private buses only",
    )

    @model_validator(mode="after")
    def _has_release_or_store(self) -> Self:
        if self.release is None and self.store is None:
            raise ValueError("release or store: missing; one of them must be set")
        return self

    @model_validator(mode="after")
    def _keys_overlap(self) -> Self:
        if self.next_public_key is None:
            return self
        if self.public_key is None:
            raise ValueError("next_public_key: expected public_key, too")
        first, last = self.next_public_key_first_day, self.public_key_last_day
        if first is not None and last is not None and first > last:
            raise ValueError(
                f"next_public_key_first_day: expected {last} (public_key_last_day) or before, got {first}"
            )
        return self

    def trusted_key(self, now_ns: Callable[[], int]) -> TrustedKey | None:
        """Return the key that releases must be signed with, or the two of a rotation; None: signatures do not count."""
        if self.public_key is None:
            return None
        keys = [DatedKey(key=load_public_key(self.public_key), last_day=self.public_key_last_day)]
        if self.next_public_key is not None:
            following = load_public_key(self.next_public_key)
            keys.append(DatedKey(key=following, first_day=self.next_public_key_first_day))
        return KeyRotation(keys=tuple(keys), now_ns=now_ns)

    @field_validator("public_key", "next_public_key")
    @classmethod
    def _check_key(cls, path: Path | None) -> Path | None:
        # An unreadable key must prevent the start, never result in a service that checks no signatures.
        if path is not None:
            try:
                load_public_key(path)
            except ReleaseError as error:
                raise ValueError(str(error)) from None
        return path
