"""Settings of gnss."""

from __future__ import annotations

import math
from datetime import date
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, SecretStr, field_validator, model_validator

from camber.gnss.observations.receiver_streams import StreamProtocol
from camber.gnss.observations.signal_pairs import groups_of
from camber.gnss.position.rtk_engine import EngineOptions
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Name
from camber.transport.byte_streams import parse_source

Coordinate = Annotated[float, Field(ge=-1e7, le=1e7)]


class EngineSettings(BaseModel):
    """Masks and tests of the engine."""

    model_config = ConfigDict(extra="forbid")

    gps_bands: str = Field("125", description="bands of GPS and QZSS that are used, by their RINEX digits")
    galileo_bands: str = Field("157", description="the same of Galileo; empty: it is not used")
    beidou_bands: str = Field("12567", description="the same of BeiDou")
    lowest_elevation_deg: float = Field(10.0, ge=0.0, le=60.0, description="lower satellites are not used")
    least_cn0_dbhz: float = Field(30.0, ge=0.0, le=60.0, description="weaker signals are not used")
    least_ratio: float = Field(3.0, ge=1.0, le=100.0, description="threshold of the ratio test")
    failure_rate: float = Field(
        0.0,
        ge=0.0,
        le=0.01,
        description="share of wrong integers that the ratio is to keep, in place of least_ratio; 0: not used",
    )
    least_success_rate: float = Field(
        0.95, ge=0.0, lt=1.0, description="bootstrapped success rate that a set of integers must promise"
    )
    least_fixed: int = Field(4, ge=3, le=100, description="ambiguities that must be fixed")
    partial: bool = Field(True, description="fix a part of the ambiguities where all cannot be")
    doppler_aided: bool = Field(
        True, description="the float position has the last one, moved by the Doppler velocity, as a prior"
    )
    ephemerides_of_satellite: int = Field(
        8,
        ge=2,
        le=1000,
        description="sets of a satellite that are kept; a whole day that is heard at once needs 150",
    )
    longest_base_age_s: float = Field(
        10.0, gt=0.0, le=60.0, description="older epochs of the base are not used"
    )
    subset_agreement: bool = Field(
        True, description="a fix says whether those from its satellites less one system agree with it"
    )

    @model_validator(mode="after")
    def _known_bands(self) -> Self:
        groups_of(self._bands())
        return self

    @field_validator("failure_rate")
    @classmethod
    def _within_the_table(cls, value: float) -> float:
        if 0.0 < value < 0.001:
            raise ValueError(f"{value}: expected 0 or from 0.001 to 0.01")
        return value

    def _bands(self) -> dict[str, str]:
        return {"G": self.gps_bands, "E": self.galileo_bands, "C": self.beidou_bands}

    def options(self) -> EngineOptions:
        """As the engine takes them."""
        return EngineOptions(
            bands=self._bands(),
            lowest_elevation_rad=math.radians(self.lowest_elevation_deg),
            least_cn0_dbhz=self.least_cn0_dbhz,
            least_ratio=self.least_ratio,
            failure_rate=self.failure_rate,
            least_success=self.least_success_rate,
            least_fixed=self.least_fixed,
            partial=self.partial,
            doppler_aided=self.doppler_aided,
            longest_age_s=self.longest_base_age_s,
            ephemerides_of_satellite=self.ephemerides_of_satellite,
        )


class GnssSettings(ServiceSettings):
    """Where the receiver and the base station are, what they speak, who solves."""

    SERVICE: ClassVar[str] = "gnss"

    source: str = Field(
        "bus",
        description="the receiver: bus, file:PATH, tcp:HOST:PORT, serial:DEVICE[:BAUD] or ntrip[s]://HOST:PORT/MOUNT",
    )
    protocol: StreamProtocol = Field("nmea", description="of a source that is not the bus")
    positions: Literal["receiver", "engine"] = Field(
        "receiver",
        description="whose positions are published: the receiver's own, or those of Camber's engine",
    )
    base_source: str | None = Field(
        None,
        description="the base station, as source; unset: through the bus, or in the receiver's own stream",
    )
    base_protocol: StreamProtocol = Field("rtcm", description="of the base station's source")
    base_ecef_m: tuple[Coordinate, Coordinate, Coordinate] | None = Field(
        None, description="the base's antenna, ECEF; unset: as its own stream says"
    )
    datum: Name = Field("WGS84", description="of the positions, as the base or the corrections define it")
    nmea_date: date | None = Field(None, description="UTC date of a stream that has neither RMC nor ZDA")
    publish_observations: bool = Field(False, description="publish the receiver's raw observations")
    ntrip_user: str | None = Field(None, description="user of the NTRIP caster")
    ntrip_password: SecretStr | None = Field(None, description="password of the NTRIP caster")
    ntrip_version: Literal[1, 2] = Field(2, description="revision of NTRIP in which the caster is asked")
    ntrip_ca_file: Path | None = Field(
        None, description="authorities of the caster's certificate; unset: the system's"
    )
    position_interval_s: float = Field(
        10.0, ge=1.0, le=3600.0, description="how often the caster is told the position"
    )
    silence_s: float = Field(15.0, ge=1.0, le=3600.0, description="a silent source is opened anew after this")
    engine: EngineSettings = Field(
        default_factory=EngineSettings, description="masks and tests of the engine"
    )

    @field_validator("source", "base_source")
    @classmethod
    def _known_source(cls, value: str | None) -> str | None:
        if value is not None and value != "bus":
            parse_source(value)
        return value
