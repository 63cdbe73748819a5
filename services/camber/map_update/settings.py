"""Settings of the fleet's store: where, in which role of how many workers, and what is impossible."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal, Self
from urllib.parse import urlsplit

from pydantic import Field, SecretStr, ValidationInfo, field_validator, model_validator

from camber.map_update.admission import Rules
from camber.map_update.fusion.pipeline import Rules as FusionRules
from camber.map_update.fusion.publication import PublicationRules
from camber.map_update.stores.shards import Shards
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Name

_DAY_S = 86_400.0


class MapUpdateSettings(ServiceSettings):
    """Settings of map_update: where uploads are stored, and which are impossible."""

    SERVICE: ClassVar[str] = "map_update"

    state_dir: Path = Field(Path("state/map_update"), description="folder of uploads.sqlite; on a local disk")
    busy_s: float = Field(
        0.5, ge=0.0, le=5.0, description="longest wait of a commit for another user of uploads.sqlite"
    )
    datums: list[Name] = Field(
        default_factory=lambda: ["WGS84", "ITRF2014", "ITRF2020", "JGD2011"],
        min_length=1,
        description="datums of positions and ellipsoidal heights that the fusion can bring together",
    )
    future_limit_s: float = Field(
        3600.0, ge=0.0, description="how far a positioning time may lie ahead of this machine's clock"
    )
    lowest_road_m: float = Field(-600.0, description="lowest ellipsoidal height of a road")
    highest_road_m: float = Field(7000.0, description="highest ellipsoidal height of a road")
    least_sigma_m: float = Field(
        0.001, gt=0.0, description="smallest standard deviation of a road height believed"
    )
    largest_sigma_m: float = Field(
        10.0, gt=0.0, description="largest standard deviation of a road height of any use"
    )
    highest_antenna_m: float = Field(20.0, gt=0.0, description="highest antenna above the road")
    most_records: int = Field(20_000, ge=1, description="most records in one batch")

    store: str | None = Field(
        None,
        description="database of uploads, `postgresql://user@host:port/database`; unset: uploads.sqlite in `state_dir`",
    )
    store_password: SecretStr | None = Field(
        None, description="password of `store`; unset: PGPASSWORD or the file of passwords, as for psql"
    )
    queue: str | None = Field(
        None,
        description="JetStream between workers that receive and that store, `nats://user@host:port`; unset: none",
    )
    queue_password: SecretStr | None = Field(None, description="password of `queue`")
    role: Literal["all", "receive", "store", "fuse"] = Field(
        "all",
        description="all: receive, store and fuse; receive: hand over to `queue`; store: take what is of `shard` "
        "from it, and fuse; fuse: only fuse what others store in `store`",
    )
    shards: list[str] = Field(
        default_factory=lambda: [""],
        description="parts of the world with a database each, by how the keys of their tiles begin; empty: all",
    )
    shard: str = Field("", description="the one of `shards` that this worker stores")
    answer_s: float = Field(
        2.0, gt=0.0, le=5.0, description="longest wait for an answer of `store` or `queue`; vehicles wait 5 s"
    )
    retention_days: float = Field(
        30.0,
        gt=0.0,
        le=36500.0,
        description="observations are deleted this long after they came, once they are fused",
    )
    reference: Path | None = Field(
        None,
        description="folder of the release that the fleet's corrections are against; unset: nothing is fused",
    )
    releases: Path | None = Field(
        None, description="folder where releases are made and served from; unset: `releases` in `state_dir`"
    )
    signing_key: Path | None = Field(
        None, description="PEM file of the Ed25519 key that signs releases; unset: they are not signed"
    )
    voters_key: Path | None = Field(
        None,
        description="file of 16 to 64 random bytes that vehicles' pseudonyms are made with; unset: voters.key in "
        "`state_dir`, made at the first start; all workers of a database need the same",
    )
    fuse_every_s: float = Field(
        60.0, gt=0.0, le=86_400.0, description="how often what has come is fused, and decided of"
    )
    fuse_records: int = Field(
        200_000, ge=1, description="about how many records are fused in a round of the work loop"
    )
    street_m: float = Field(
        300.0,
        ge=10.0,
        le=10_000.0,
        description="side of the squares that count as one street: a vehicle's bias there is told by the others",
    )
    publish_threshold_m: float = Field(0.03, gt=0.0, le=1.0, description="a smaller change is not published")
    publish_standard_errors: float = Field(
        3.3, ge=2.0, le=10.0, description="by so many standard errors a change exceeds the threshold"
    )
    publish_vehicles: int = Field(5, ge=2, description="fewest vehicles that have seen a change")
    publish_days: int = Field(2, ge=1, le=56, description="fewest days on which it was seen")
    publish_largest_m: float = Field(0.5, gt=0.0, le=10.0, description="a larger change waits for review")
    false_discovery_rate: float = Field(
        0.01, gt=0.0, le=0.2, description="bound of the share of false ones among published changes"
    )
    oldest_upload_days: float | None = Field(
        None,
        gt=0.0,
        le=36500.0,
        description="observations older than this are refused, and their rows of the ledger deleted in time; unset: "
        "any age is taken, and the ledger kept for ever",
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
                "no password in an address, which logs and the list of processes show;"
                f" set CAMBER_MAP_UPDATE_{(info.field_name or '').upper()}_PASSWORD"
            )
        return address

    @model_validator(mode="after")
    def _workers(self) -> Self:
        if (self.queue is None) != (self.role in ("all", "fuse")):
            raise ValueError(
                "role: a worker that only receives or only stores needs a queue, and no other has one"
            )
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

    def fusion_rules(self) -> FusionRules:
        """What is published, as the fusion wants it."""
        return FusionRules(
            street_m=self.street_m,
            publication=PublicationRules(
                threshold_m=self.publish_threshold_m,
                standard_errors=self.publish_standard_errors,
                false_discovery_rate=self.false_discovery_rate,
                least_vehicles=self.publish_vehicles,
                least_days=self.publish_days,
                largest_m=self.publish_largest_m,
            ),
        )

    def rules(self) -> Rules:
        """The bounds as the admission wants them."""
        return Rules(
            datums=frozenset(self.datums),
            future_limit_s=self.future_limit_s,
            lowest_road_m=self.lowest_road_m,
            highest_road_m=self.highest_road_m,
            least_sigma_m=self.least_sigma_m,
            largest_sigma_m=self.largest_sigma_m,
            highest_antenna_m=self.highest_antenna_m,
            most_records=self.most_records,
            oldest_s=None if self.oldest_upload_days is None else self.oldest_upload_days * _DAY_S,
        )

    @property
    def ledger_s(self) -> float | None:
        """After so long what was received would be refused if it came again; None: never.

        Its times are at most `future_limit_s` after it was received, and clocks are set back by less than a day.
        """
        if self.oldest_upload_days is None:
            return None
        return (self.oldest_upload_days + 1.0) * _DAY_S + self.future_limit_s
