"""Settings of the vehicle's sensors."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

from camber.formats.lidar_can.firings import LidarDecoder
from camber.formats.lidar_can.ouster import OusterDecoder
from camber.formats.lidar_can.ouster_metadata import (
    FREE_RUNNING,
    LEGACY_IMU,
    OusterMetadata,
    read_ouster_metadata,
)
from camber.formats.lidar_can.velodyne import MODELS, VelodyneDecoder
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Name
from camber.sensors.can_motion import CanSettings
from camber.sensors.imu_reader import ImuReader
from camber.sensors.lidar_reader import LidarReader
from camber.sensors.sensor_clock import SensorClock, TimeScale
from camber.sensors.sources import checked_by, lidar_source, text_of


class LidarSettings(BaseModel):
    """Where the LiDAR's packets come from, what it is, what its clock counts."""

    model_config = ConfigDict(extra="forbid")

    source: Annotated[str, AfterValidator(checked_by(lidar_source))] | None = Field(
        None,
        description="udp:PORT, udp:ADDRESS:PORT (its own or a multicast group's) or pcap:FILE; unset: none",
    )
    model: Literal["VLP-16", "Puck Hi-Res", "HDL-32E", "VLP-32C", "ouster"] | None = Field(
        None, description="must be set; a Puck LITE is a VLP-16"
    )
    metadata: Path | None = Field(
        None, description="the metadata of an Ouster, JSON, as the sensor gives them"
    )
    stamps: TimeScale | None = Field(
        None,
        description="what its clock counts: utc_hour, utc, tai, gps, or arrival: free-running; must be set",
    )
    clock_offset_s: float = Field(0.0, ge=-10.0, le=10.0, description="added to the times of its clock")
    most_clock_error_s: float = Field(
        0.1,
        gt=0.0,
        le=10.0,
        description="packets whose time is further from this machine's clock are refused",
    )
    name: Name = Field("lidar", description="the sensor's name in its sweeps")
    sender: str | None = Field(None, description="address of the sensor; packets of others are passed over")
    port: Annotated[int, Field(ge=1, le=65_535)] | None = Field(
        None, description="UDP port in a recording; unset: 2368, of an Ouster 7502"
    )
    imu_port: Annotated[int, Field(ge=1, le=65_535)] | None = Field(
        None, description="UDP port of an Ouster's IMU packets, 7503 as a rule; unset: they are not read"
    )
    seam_deg: float = Field(
        180.0,
        ge=0.0,
        lt=360.0,
        description="where sweeps begin, clockwise from ahead; an Ouster's begin behind it",
    )
    least_share: float = Field(
        0.5, gt=0.0, le=1.0, description="of a turn that must have arrived; less is no sweep"
    )

    @field_validator("sender")
    @classmethod
    def _address(cls, value: str | None) -> str | None:
        return None if value is None else str(ipaddress.IPv4Address(value))

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if self.source is not None:
            self.reader()
            self.imu_reader()
        return self

    def reader(self) -> LidarReader:
        """The sensor that is described here. Raises ValueError where something is missing or does not fit."""
        clock = self._clock()
        return LidarReader(self.name, self._decoder(), clock, self.least_share)

    def imu_reader(self) -> ImuReader | None:
        """Its inertial unit, where that is read. Raises ValueError where it has none, or another format."""
        if self.imu_port is None:
            return None
        if self.model != "ouster" or self.metadata is None:
            raise ValueError("imu_port: an Ouster has IMU packets, expected none")
        if self.imu_port == self._lidar_port():
            raise ValueError(
                f"imu_port: {self.imu_port}, expected another port than that of the lidar packets"
            )
        metadata = self._ouster_metadata(self.metadata)
        if metadata.imu_profile != LEGACY_IMU:
            text = (
                f"imu_port: {self.metadata} has IMU packets of {metadata.imu_profile}, expected {LEGACY_IMU}"
            )
            raise ValueError(text)
        return ImuReader(metadata.imu_to_sensor[:3, :3], self._clock())

    def _lidar_port(self) -> int:
        where = None if self.source is None else lidar_source(self.source)
        return where[2] if where is not None and where[0] == "udp" else self.udp_port()

    def _clock(self) -> SensorClock:
        if self.stamps is None:
            raise ValueError("stamps: missing; what the sensor's clock counts cannot be guessed")
        offset_ns, limit_ns = round(self.clock_offset_s * 1e9), round(self.most_clock_error_s * 1e9)
        return SensorClock(self.stamps, offset_ns, limit_ns)

    def udp_port(self) -> int:
        """Of a recording."""
        return self.port or (7502 if self.model == "ouster" else 2368)

    def _decoder(self) -> LidarDecoder:
        if self.model is None:
            raise ValueError("model: missing")
        if self.model != "ouster":
            if self.metadata is not None:
                raise ValueError("metadata: an Ouster has them, expected none")
            if self.stamps not in ("utc_hour", "arrival"):
                raise ValueError(
                    f"stamps: {self.stamps}, expected utc_hour or arrival: a {self.model} counts an hour"
                )
            return VelodyneDecoder(MODELS[self.model], self.seam_deg)
        if self.metadata is None:
            raise ValueError("metadata: missing; an Ouster cannot be read without")
        if self.stamps == "utc_hour":
            raise ValueError("stamps: utc_hour, expected utc, tai, gps or arrival: an Ouster counts no hours")
        metadata = self._ouster_metadata(self.metadata)
        if metadata.timestamp_mode == FREE_RUNNING and self.stamps != "arrival":
            raise ValueError(
                f"stamps: {self.stamps}, expected arrival: {self.metadata} says that the clock is free-running"
            )
        return OusterDecoder(metadata)

    @staticmethod
    def _ouster_metadata(path: Path) -> OusterMetadata:
        return read_ouster_metadata(text_of(path, "utf-8"), path.name)


class SensorsSettings(ServiceSettings):
    """Sweeps from a LiDAR, motion from a CAN bus: live, or out of recordings."""

    SERVICE: ClassVar[str] = "sensors"

    period_s: float = Field(
        0.01, gt=0.0, le=10.0, description="longest time between two rounds of the work loop"
    )
    recordings: Literal["as_recorded", "now"] = Field(
        "as_recorded", description="times of messages from recordings; now: as if recorded now"
    )
    silence_s: float = Field(
        2.0, gt=0.0, le=3600.0, description="an input that has given nothing for so long is reported"
    )
    lidar: LidarSettings = Field(default_factory=LidarSettings, description="the LiDAR")
    can: CanSettings = Field(default_factory=CanSettings, description="the CAN bus")

    @model_validator(mode="after")
    def _has_something_to_read(self) -> Self:
        if self.clock == "replay":
            text = "clock: replay, expected system: in a replay the drive's sweeps and motion are fed"
            raise ValueError(text)
        return self
