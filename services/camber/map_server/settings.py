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
        description="folder of a release, which may come later: served, or taken into `store` where that is set",
    )
    public_key: Path | None = Field(
        None,
        description="PEM file of the Ed25519 key that releases must be signed with; unset: signatures of "
        "`release` are not asked, and over the bus nothing is taken",
    )
    datum: Name = Field("WGS84", description="datum that positions and heights must be in")
    max_age_days: float | None = Field(
        None,
        gt=0.0,
        description="a release made longer ago is stale and says nothing; unset: any age will do",
    )
    look_every_s: float = Field(2.0, gt=0.0, le=3600.0, description="how often to look for a new release")
    retry_every_s: float = Field(60.0, gt=0.0, description="how often to try a refused release again")
    verify_bytes: int = Field(
        4_000_000, gt=0, description="about how much of a new release is verified in a round of the work loop"
    )
    tiles_kept: int = Field(256, ge=32, description="how many tiles are kept ready for questions")
    store: Path | None = Field(
        None,
        description="file with the vehicle's releases, brought there from the cloud; unset: `release` is served",
    )
    region: Name | None = Field(
        None, description="region whose releases are fetched; unset: that of the map that is here"
    )
    around_km: float | None = Field(
        None, gt=0.5, le=1000.0, description="fetch the map this far around the vehicle; unset: all of it"
    )
    ask_every_s: float = Field(
        600.0, ge=0.1, description="how often at the least the cloud is asked for a newer release"
    )
    ask_spread_s: float = Field(
        10.0,
        ge=0.0,
        description="a notice of a release is followed within this time, at random: a fleet hears it at once",
    )
    store_limit_bytes: int = Field(4 << 30, ge=1 << 20, description="largest size of `store`")
    unsigned: bool = Field(
        False, description="take releases over the bus without a `public_key`: anyone's, on a bus of your own"
    )

    @model_validator(mode="after")
    def _there_is_a_map(self) -> Self:
        if self.release is None and self.store is None:
            raise ValueError("release or store: missing; one of them must be set")
        return self

    @field_validator("public_key")
    @classmethod
    def _key_is_there(cls, path: Path | None) -> Path | None:
        # A key that cannot be read must end the start, never turn into a service that asks for no signature.
        if path is not None:
            try:
                load_public_key(path)
            except ReleaseError as error:
                raise ValueError(str(error)) from None
        return path
