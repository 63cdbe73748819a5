"""Settings of the vehicle's sensors."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from camber.formats.lidar_can.dbc import DbcMessage, read_dbc
from camber.formats.lidar_can.firings import LidarDecoder
from camber.formats.lidar_can.ouster import OusterDecoder
from camber.formats.lidar_can.ouster_metadata import FREE_RUNNING, OusterMetadata, read_ouster_metadata
from camber.formats.lidar_can.velodyne import MODELS, VelodyneDecoder
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Name
from camber.sensors.can_motion import QUANTITIES, CanMotion, Gives, SignalUse
from camber.sensors.lidar_reader import LidarReader
from camber.sensors.sensor_clock import SensorClock, TimeScale
from camber.sensors.units import Unit

Port = Annotated[int, Field(ge=1, le=65_535)]


class LidarSettings(BaseModel):
    """Where the LiDAR's packets come from, what it is, what its clock counts."""

    model_config = ConfigDict(extra="forbid")

    source: str | None = Field(
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
    port: Port | None = Field(None, description="UDP port in a recording; unset: 2368, of an Ouster 7502")
    seam_deg: float = Field(
        180.0,
        ge=0.0,
        lt=360.0,
        description="where sweeps begin, clockwise from ahead; an Ouster's begin behind it",
    )
    least_share: float = Field(
        0.5, gt=0.0, le=1.0, description="of a turn that must have arrived; less is no sweep"
    )

    @field_validator("source")
    @classmethod
    def _known_source(cls, value: str | None) -> str | None:
        if value is not None:
            lidar_source(value)
        return value

    @field_validator("sender")
    @classmethod
    def _address(cls, value: str | None) -> str | None:
        return None if value is None else str(ipaddress.IPv4Address(value))

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if self.source is not None:
            self.reader()
        return self

    def reader(self) -> LidarReader:
        """The sensor that is described here. Raises ValueError where something is missing or does not fit."""
        if self.stamps is None:
            raise ValueError("stamps: missing; what the sensor's clock counts cannot be guessed")
        clock = SensorClock(
            self.stamps, round(self.clock_offset_s * 1e9), round(self.most_clock_error_s * 1e9)
        )
        return LidarReader(self.name, self._decoder(), clock, self.least_share)

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
        said = _metadata(self.metadata)
        if said.timestamp_mode == FREE_RUNNING and self.stamps != "arrival":
            raise ValueError(
                f"stamps: {self.stamps}, expected arrival: {self.metadata} says that the clock is free-running"
            )
        return OusterDecoder(said)


class SignalSettings(BaseModel):
    """One quantity on the CAN bus."""

    model_config = ConfigDict(extra="forbid")

    signal: str | None = Field(
        None, description="MESSAGE.SIGNAL of the DBC file; unset: the vehicle has none"
    )
    unit: Unit | None = Field(None, description="of the signal; must be set")
    invalid: tuple[int, ...] = Field(
        (), description="raw values that mean: not known; of a signed signal with its sign"
    )
    scale: float = Field(
        1.0,
        ge=-1e3,
        le=1e3,
        description="times this; −1 where it counts the other way, 1 / ratio of a steering wheel",
    )

    @field_validator("scale")
    @classmethod
    def _not_zero(cls, value: float) -> float:
        if value == 0.0:
            raise ValueError("0, expected a factor")
        return value


class CanSettings(BaseModel):
    """Where the CAN bus is, and what its signals mean."""

    model_config = ConfigDict(extra="forbid")

    source: str | None = Field(None, description="socketcan:INTERFACE or candump:FILE; unset: none")
    dbc: Path | None = Field(None, description="the DBC file; must be set")
    bus: str | None = Field(
        None, description="of a log with several: the interface that is read; unset: the first"
    )
    clock_offset_s: float = Field(
        0.0,
        ge=-10.0,
        le=10.0,
        description="added to the time at which a frame came: minus what it was under way",
    )
    trigger: str | None = Field(
        None,
        description="message that makes a motion; unset: that of the yaw rate, without one of the wheels",
    )
    oldest_s: float = Field(0.1, gt=0.0, le=10.0, description="older values of other messages are not known")
    reverse_codes: tuple[int, ...] = Field((), description="raw values of reverse_gear that mean backwards")
    forward_codes: tuple[int, ...] = Field(
        (), description="those that mean forwards; with any other the speed is not known"
    )
    stroke_sigma_m: float = Field(0.003, gt=0.0, le=1.0, description="σ of the stroke")
    wheel_speed: SignalSettings = Field(default_factory=SignalSettings, description="forward")
    yaw_rate: SignalSettings = Field(default_factory=SignalSettings, description="positive to the left")
    steering_angle: SignalSettings = Field(default_factory=SignalSettings, description="positive to the left")
    pitch: SignalSettings = Field(default_factory=SignalSettings, description="positive nose down")
    roll: SignalSettings = Field(default_factory=SignalSettings, description="positive left side up")
    stroke_height: SignalSettings = Field(default_factory=SignalSettings, description="of the suspension")
    reverse_gear: SignalSettings = Field(
        default_factory=SignalSettings, description="where the wheel speed has no sign"
    )

    @field_validator("source")
    @classmethod
    def _known_source(cls, value: str | None) -> str | None:
        if value is not None:
            can_source(value)
        return value

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if self.source is not None:
            self.reader()
        return self

    def reader(self) -> CanMotion:
        """The signals that are described here. Raises ValueError where something is missing or does not fit."""
        if self.dbc is None:
            raise ValueError("dbc: missing; the bus cannot be read without")
        uses: dict[Gives, SignalUse] = {}
        for gives in QUANTITIES:
            one: SignalSettings = getattr(self, gives)
            if one.signal is not None:
                uses[gives] = SignalUse(one.signal, one.unit, one.invalid, one.scale)
        if not uses.keys() - {"reverse_gear"}:
            raise ValueError("wheel_speed, yaw_rate …: missing; expected at least one signal")
        if "reverse_gear" in uses and not self.reverse_codes:
            raise ValueError("reverse_codes: missing; which values of reverse_gear mean backwards?")
        if "reverse_gear" in uses and not self.forward_codes:
            raise ValueError("forward_codes: missing; which values of reverse_gear mean forwards?")
        if both := set(self.reverse_codes) & set(self.forward_codes):
            raise ValueError(f"forward_codes: {min(both)} is in reverse_codes too")
        return CanMotion(
            _messages(self.dbc),
            uses,
            trigger=self.trigger,
            oldest_ns=round(self.oldest_s * 1e9),
            reverse=self.reverse_codes,
            forward=self.forward_codes,
            stroke_sigma_m=self.stroke_sigma_m,
        )


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
            raise ValueError(
                "clock: replay, expected system: in a replay the drive's sweeps and motion are fed"
            )
        return self


def lidar_source(text: str) -> tuple[Literal["udp"], str, int] | tuple[Literal["pcap"], Path]:
    """Raises ValueError for what is neither, and for a recording that is not there."""
    kind, _, rest = text.partition(":")
    if kind == "pcap" and rest:
        return "pcap", _there(rest)
    address, _, port = rest.rpartition(":")
    if kind == "udp" and port.isdecimal() and 0 < int(port[:6]) < 65_536:
        return "udp", str(ipaddress.IPv4Address(address)) if address else "", int(port)
    raise ValueError(f"{text!r}: expected udp:PORT, udp:ADDRESS:PORT or pcap:FILE")


def can_source(text: str) -> tuple[Literal["socketcan"], str] | tuple[Literal["candump"], Path]:
    """Raises ValueError for what is neither, and for a recording that is not there."""
    kind, _, rest = text.partition(":")
    if kind == "candump" and rest:
        return "candump", _there(rest)
    if kind == "socketcan" and 0 < len(rest) < 16:
        return "socketcan", rest
    raise ValueError(f"{text!r}: expected socketcan:INTERFACE or candump:FILE")


def _there(text: str) -> Path:
    path = Path(text)
    if not path.is_file():
        raise ValueError(f"{path}: no such file")
    return path


def _text(path: Path, encoding: str) -> str:
    try:
        return path.read_text(encoding, "replace")
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}") from None


def _metadata(path: Path) -> OusterMetadata:
    return read_ouster_metadata(_text(path, "utf-8"), path.name)


def _messages(path: Path) -> dict[str, DbcMessage]:
    return read_dbc(_text(path, "cp1252"), path.name)
