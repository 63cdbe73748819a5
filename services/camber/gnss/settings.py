"""Settings of the GNSS receiver adapter."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, SecretStr, field_validator, model_validator

from camber.gnss.observations.receiver_streams import StreamProtocol
from camber.gnss.position.engine_settings import EngineSettings
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Name
from camber.transport.byte_streams import parse_source

Coordinate = Annotated[float, Field(ge=-1e7, le=1e7)]


class GnssSettings(ServiceSettings):
    """Sources and protocols of receiver and base station, and which positions are published."""

    SERVICE: ClassVar[str] = "gnss"

    source: str = Field(
        "bus",
        description="the receiver: bus, file:PATH, tcp:HOST:PORT, serial:DEVICE[:BAUD] or ntrip[s]://HOST:PORT/MOUNT",
    )
    protocol: StreamProtocol = Field("nmea", description="protocol of source; not used for the bus")
    positions: Literal["receiver", "engine"] = Field(
        "receiver", description="positions to publish: those of the receiver, or of Camber's RTK engine"
    )
    base_source: str | None = Field(
        None, description="the base station, as source; unset: from the bus, or in the receiver's stream"
    )
    base_protocol: StreamProtocol = Field("rtcm", description="protocol of base_source")
    forward_corrections: bool = Field(
        False,
        description="send the base station's bytes to the receiver, which solves its positions itself; "
        "source is then serial: or tcp:",
    )
    base_ecef_m: tuple[Coordinate, Coordinate, Coordinate] | None = Field(
        None, description="ECEF coordinate of the base's antenna; unset: from its stream"
    )
    confirmed_bases: tuple[Name, ...] = Field(
        (),
        max_length=64,
        description="stations with a new coordinate that an operator has confirmed, as the issue base_moved names them",
    )
    datum: Name = Field("WGS84", description="datum of the positions, defined by the base or the corrections")
    nmea_date: date | None = Field(None, description="UTC date of a stream without RMC and ZDA")
    publish_observations: bool = Field(False, description="publish the receiver's raw observations")
    satellites_every_s: float = Field(
        1.0,
        ge=0.0,
        le=3600.0,
        description="shortest time between two messages of the satellites in view; 0: one for each epoch",
    )
    ntrip_user: str | None = Field(None, description="user of the NTRIP caster")
    ntrip_password: SecretStr | None = Field(None, description="password of the NTRIP caster")
    ntrip_version: Literal[1, 2] = Field(2, description="NTRIP version of the requests")
    ntrip_ca_file: Path | None = Field(
        None, description="CA certificates for the caster; unset: the system's"
    )
    position_interval_s: float = Field(
        10.0, ge=1.0, le=3600.0, description="interval at which the position is sent to the caster"
    )
    silence_s: float = Field(15.0, ge=1.0, le=3600.0, description="a source is reopened after this silence")
    engine: EngineSettings = Field(default_factory=EngineSettings, description="parameters of the RTK engine")

    @field_validator("source", "base_source")
    @classmethod
    def _known_source(cls, value: str | None) -> str | None:
        if value is not None and value != "bus":
            parse_source(value)
        return value

    @model_validator(mode="after")
    def _can_forward(self) -> Self:
        if not self.forward_corrections:
            return self
        if self.positions != "receiver" or not self.source.startswith(("serial:", "tcp:")):
            raise ValueError("forward_corrections: expected positions = receiver and source serial: or tcp:")
        if self.base_source is None:
            raise ValueError("forward_corrections: expected base_source, whose bytes are sent")
        return self
