"""Settings of gnss."""

from __future__ import annotations

from datetime import date
from typing import ClassVar, Literal

from pydantic import Field, field_validator

from camber.formats.byte_streams import source_of
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Name


class GnssSettings(ServiceSettings):
    """Where the receiver is, and what it speaks."""

    SERVICE: ClassVar[str] = "gnss"

    source: str = Field("bus", description="bus, file:PATH, tcp:HOST:PORT or serial:DEVICE[:BAUD]")
    protocol: Literal["pos", "nmea"] = Field("nmea", description="of a source that is not the bus")
    datum: Name = Field("WGS84", description="of the receiver's positions, as its corrections define it")
    nmea_date: date | None = Field(None, description="UTC date of a stream that has neither RMC nor ZDA")

    @field_validator("source")
    @classmethod
    def _known_source(cls, value: str) -> str:
        if value != "bus":
            source_of(value)
        return value
