"""Settings of the map server."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Self

from pydantic import Field, field_validator, model_validator

from camber.road_map.release import ReleaseError, load_public_key
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Name


class MapServerSettings(ServiceSettings):
    """Serves road elevation, links and tiles from a release of the map."""

    SERVICE: ClassVar[str] = "map_server"

    release: Path | None = Field(
        None,
        description="folder of a release, which may appear later: served, or imported into `store` if that is set",
    )
    public_key: Path | None = Field(
        None,
        description="PEM file of the Ed25519 key that releases must be signed with; unset: signatures of "
        "`release` are not checked, and releases from the bus are refused",
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
    region: Name | None = Field(
        None, description="region of the releases to download; unset: that of the present map"
    )
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

    @field_validator("public_key")
    @classmethod
    def _check_key(cls, path: Path | None) -> Path | None:
        # An unreadable key must prevent the start, never result in a service that checks no signatures.
        if path is not None:
            try:
                load_public_key(path)
            except ReleaseError as error:
                raise ValueError(str(error)) from None
        return path
