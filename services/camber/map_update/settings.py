"""Settings of map_update: storage, role among several workers, admission of uploads, fusion."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal, Self
from urllib.parse import urlsplit

from pydantic import Field, SecretStr, ValidationInfo, field_validator, model_validator

from camber.map_update.admission import AdmissionLimits
from camber.map_update.fusion.pipeline import FusionSettings
from camber.map_update.stores.shards import Shards
from camber.runtime.settings import ServiceSettings

_DAY_S = 86_400.0  # seconds of a day


class MapUpdateSettings(AdmissionLimits, FusionSettings, ServiceSettings):
    """Settings of map_update: storage of uploads, admission limits, fusion."""

    SERVICE: ClassVar[str] = "map_update"

    state_dir: Path = Field(Path("state/map_update"), description="folder of uploads.sqlite; on a local disk")
    busy_s: float = Field(
        0.5, ge=0.0, le=5.0, description="longest wait of a commit for another user of uploads.sqlite"
    )
    store: str | None = Field(
        None,
        description="database of uploads, `postgresql://user@host:port/database`; unset: uploads.sqlite in `state_dir`",
    )
    store_password: SecretStr | None = Field(
        None, description="password of `store`; unset: PGPASSWORD or the password file, as for psql"
    )
    queue: str | None = Field(
        None,
        description="JetStream between receiving and storing workers, `nats://user@host:port`; unset: none",
    )
    queue_password: SecretStr | None = Field(None, description="password of `queue`")
    role: Literal["all", "receive", "store", "fuse"] = Field(
        "all",
        description="all: receive, store and fuse; receive: forward to `queue`; store: store the uploads of `shard` "
        "from the queue, and fuse; fuse: only fuse what others store in `store`",
    )
    shards: list[str] = Field(
        default_factory=lambda: [""],
        description="parts of the world with a database each, as prefixes of tile keys; empty: one for all",
    )
    shard: str = Field("", description="the one of `shards` that this worker stores")
    answer_s: float = Field(
        2.0, gt=0.0, le=5.0, description="longest wait for a reply of `store` or `queue`; vehicles wait 5 s"
    )
    retention_days: float = Field(
        30.0,
        gt=0.0,
        le=36500.0,
        description="observations are deleted this long after they were received, once they are fused",
    )
    reference: Path | None = Field(
        None, description="folder of the release that the fleet's corrections refer to; unset: no fusion"
    )
    releases: Path | None = Field(
        None, description="folder of the releases made and served; unset: `releases` in `state_dir`"
    )
    signing_key: Path | None = Field(
        None, description="PEM file of the Ed25519 key that signs releases; unset: releases are not signed"
    )
    operator_keys: Path | None = Field(
        None,
        description="folder of public keys, NAME.pub, of those who decide on changes; unset: nobody decides over the "
        "bus, and a decision in the folder of releases needs no signature",
    )
    voters_key: Path | None = Field(
        None,
        description="file of 16 to 64 random bytes, the key of the vehicles' pseudonyms; unset: voters.key in "
        "`state_dir`, made at the first start; all workers of a database need the same",
    )
    fuse_every_s: float = Field(60.0, gt=0.0, le=86_400.0, description="period of the fusion")
    fuse_records: int = Field(
        200_000, ge=1, description="approximate records fused in one iteration of the work loop"
    )

    @field_validator("store", "queue")
    @classmethod
    def _address(cls, address: str | None, info: ValidationInfo) -> str | None:
        if address is None:
            return None
        schemes = {"store": ("postgresql", "postgres"), "queue": ("nats",)}[info.field_name or ""]
        try:
            parts = urlsplit(address)
            known = parts.scheme in schemes and bool(parts.hostname) and parts.port != 0
        except ValueError:
            known = False
        if not known:
            raise ValueError(f"expected {schemes[0]}://user@host:port")
        if parts.password is not None or "password=" in parts.query:
            raise ValueError(
                "no password in an address, which logs and the process list show;"
                f" set CAMBER_MAP_UPDATE_{(info.field_name or '').upper()}_PASSWORD"
            )
        return address

    @model_validator(mode="after")
    def _roles_are_consistent(self) -> Self:
        if (self.queue is None) != (self.role in ("all", "fuse")):
            raise ValueError("role: receive and store need a queue, all and fuse have none")
        if self.role == "fuse" and self.reference is None:
            raise ValueError("reference: unset, expected a release's folder for a worker that fuses")
        if self.role == "receive" and self.reference is not None:
            raise ValueError("reference: a worker that receives fuses nothing, expected it unset")
        Shards(self.shards)
        if self.role == "store" and self.shard not in self.shards:
            raise ValueError(f"shard: {self.shard!r}, expected one of {self.shards}")
        if self.role in ("all", "fuse") and self.shards != [""]:
            raise ValueError("shards: a worker without a queue has one")
        return self

    @property
    def ledger_s(self) -> float | None:
        """Time after which a repeated upload would be refused for its age, so its ledger row can go; None: never.

        Positioning times are at most `future_limit_s` later than reception, and clocks are set back by less than a day.
        """
        if self.oldest_upload_days is None:
            return None
        return (self.oldest_upload_days + 1.0) * _DAY_S + self.future_limit_s
