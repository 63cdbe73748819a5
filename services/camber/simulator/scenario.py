"""The scenario file of the simulator: where, when, what drives, what is recorded, what goes wrong.

`docs/simulator.md` describes it; scenarios that come with Camber are in `scenarios/`.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from camber.geodesy.gps_time import CalendarTime, gps_ns_from_gpst
from camber.schemas.base import Model, Name, Text
from camber.schemas.motion import ImuClass, MountedImu
from camber.schemas.toml_file import FileError, Overrides, load_toml
from camber.simulator.injected_faults import Fault, refused_sum
from camber.simulator.world.district import KINDS, Kind

_FOLDER = Path(__file__).parent / "scenarios"

Seed = Annotated[int, Field(ge=0, lt=2**63)]


class ScenarioError(FileError):
    """The scenario cannot be used; one clear line."""


def _without_zone(value: datetime) -> datetime:
    if value.tzinfo is not None:
        text = "expected a date and time of GPS time, without a zone, such as 2026-03-20T01:30:00"
        raise PydanticCustomError("time", text)
    return value


class DistrictPlace(Model):
    """The district."""

    kind: Kind = Field(description="one of " + ", ".join(KINDS))
    latitude_deg: float = Field(default=35.17, ge=-80.0, le=80.0, description="of the district's origin")
    longitude_deg: float = Field(default=136.88, ge=-180.0, le=180.0, description="the same")
    heading_deg: Annotated[float, Field(ge=0.0, lt=360.0)] | None = Field(
        default=None, description="of the street, clockwise from north; where there is one street only"
    )
    changed_roads: bool = Field(
        default=False, description="have roads been raised or lowered since the survey?"
    )
    route: Literal["default", "rounds"] = Field(
        default="default",
        description="path through the district; rounds: in a city, for nine minutes and more",
    )
    seed: Seed | None = Field(
        default=None,
        description="seed of the district and its survey, so that other drives see the same; else the scenario's",
    )

    @model_validator(mode="after")
    def _has_the_route(self) -> Self:
        if self.route == "rounds" and self.kind != "city":
            raise PydanticCustomError("route", "route is rounds, expected default: only a city has rounds")
        return self


class Lidar(Model):
    """The surround sensor."""

    beams: Literal[32, 64] = Field(default=64, description="32 or 64")
    traffic: int = Field(default=6, ge=0, le=100, description="moving vehicles around")
    packets: Literal["velodyne", "ouster"] | None = Field(
        default=None,
        description="velodyne (an HDL-32E) or ouster (an OS1-64) in place of beams, with its packets and a CAN bus",
    )


class SimulatedImu(MountedImu):
    """The inertial measurement unit."""

    imu_class: ImuClass = Field(default="mems", alias="class", description="phone, mems or tactical")
    rate_hz: float = Field(default=200.0, ge=50.0, le=400.0, description="samples a second")
    x_m: float = Field(default=0.2, ge=-50.0, le=50.0, description="forward of the rear axle's middle")
    y_m: float = Field(default=-0.1, ge=-50.0, le=50.0, description="left of it")
    z_m: float = Field(default=0.4, ge=-50.0, le=50.0, description="above the road at rest")


class Satellites(Model):
    """What the sky and the receiver give."""

    systems: str = Field(
        default="GJEC", pattern="^[GJEC]+$", description="letters of GPS, QZSS (J), Galileo (E), BeiDou (C)"
    )
    rate_hz: Literal[1, 2, 5, 10] = Field(default=10, description="epochs a second: 1, 2, 5 or 10")
    base_distance_m: float = Field(
        default=3_000.0, ge=100.0, le=20_000.0, description="of the base station, to the north-east"
    )
    streams: bool = Field(default=True, description="RTCM and UBX streams with the RINEX files")
    reference_m: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="error of antenna, lever arm and map reference, metres, in a direction that turns with the vehicle",
    )
    frame_sigma_m: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="σ, each horizontal axis, of the constant offset of the base's frame from the map's",
    )


class Fleet(Model):
    """Many vehicles over one district, by what they would upload."""

    vehicles: int = Field(default=100, ge=1, le=100_000, description="how many")
    drives_each: int = Field(default=3, ge=1, le=1_000, description="drives of each of them")
    rate_hz: float = Field(default=5.0, gt=0.0, le=10.0, description="records a second of driving")
    attackers: float = Field(
        default=0.0, ge=0.0, le=0.5, description="share of vehicles that upload a made-up height"
    )
    days: int = Field(default=3, ge=1, le=1_000, description="over how many days the drives are spread")
    wrong_drives: float = Field(
        default=0.0, ge=0.0, le=0.5, description="share of drives of which every fix is wrong"
    )


class Scenario(Model):
    """One simulated drive, or a fleet's."""

    name: Name = Field(description="name: letters, digits and _ . : @ + -")
    description: Text = Field(default="", description="for people")
    seed: Seed = Field(default=1, description="seed of all that is random")
    start: Annotated[datetime, AfterValidator(_without_zone)] = Field(
        default=datetime(2026, 3, 20, 1, 30),
        description="GPS time of the first epoch, such as 2026-03-20T01:30:00",
    )
    duration_s: float = Field(default=120.0, gt=0.0, le=86_400.0, description="of driving")
    vehicle: Literal["car", "robot"] = Field(default="car", description="car or robot")
    yaw_rate_sensor: Literal["plain", "automotive"] = Field(
        default="plain",
        description="plain, or automotive: with instability, warming, scale and misalignment too",
    )
    motion: bool = Field(
        default=True,
        description="has the vehicle wheel speed, yaw rate, steering and attitude? false: no motion.csv",
    )
    place: DistrictPlace = Field(description="table with the district")
    satellites: Satellites = Field(default=Satellites(), description="table of what is received")
    lidar: Lidar | None = Field(default=None, description="table of the surround sensor")
    imu: SimulatedImu | None = Field(default=None, description="table of an inertial measurement unit")
    fleet: Fleet | None = Field(default=None, description="table of a fleet; then nothing else is made")
    faults: Annotated[tuple[Fault, ...], Field(strict=False)] = Field(
        default=(), max_length=64, description="list of what goes wrong, and when"
    )

    @model_validator(mode="after")
    def _faults_happen(self) -> Self:
        for number, fault in enumerate(self.faults):
            if fault.onset_s >= self.duration_s:
                raise PydanticCustomError(
                    "late",
                    "faults.{number}: onset_s is {onset_s}, expected one before the end, {duration_s} s",
                    {"number": number, "onset_s": fault.onset_s, "duration_s": self.duration_s},
                )
        return self

    @model_validator(mode="after")
    def _faults_can_act(self) -> Self:
        kinds = {fault.kind for fault in self.faults}
        cannot = {
            "a table lidar": self.lidar is None and kinds & {"blocked_lidar", "symmetric_scene"},
            "vehicle = 'car': a robot has no springs": self.vehicle == "robot" and kinds & {"changed_load"},
            "motion = true: no wheel speed is measured": not self.motion and kinds & {"wheel_slip"},
            "no table fleet": self.fleet is not None and kinds,
        }
        for expected, idle in cannot.items():
            if idle:
                text = "fault {kind} cannot act, expected {expected}"
                raise PydanticCustomError("idle", text, {"kind": min(idle), "expected": expected})
        return self

    @model_validator(mode="after")
    def _packets_have_motion(self) -> Self:
        if not self.motion and self.lidar is not None and self.lidar.packets is not None:
            text = "lidar.packets is set, expected motion = true: its CAN bus carries the motion"
            raise PydanticCustomError("packets", text)
        return self

    @model_validator(mode="after")
    def _faults_fit_together(self) -> Self:
        refused = refused_sum(self.faults)
        if refused is not None:
            raise PydanticCustomError("together", "faults: {refused}", {"refused": refused})
        return self

    @property
    def start_ns(self) -> int:
        """GPS time of the first epoch."""
        t = self.start
        return gps_ns_from_gpst(CalendarTime(*t.timetuple()[:6], nanosecond=1000 * t.microsecond))


def shipped() -> tuple[str, ...]:
    """Names of the scenarios that come with Camber."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))


def load_scenario(name_or_path: str, overrides: Overrides = ()) -> Scenario:
    """A shipped scenario by its name, or one from a file; raises ScenarioError with one line."""
    path = _FOLDER / f"{name_or_path}.toml" if name_or_path in shipped() else Path(name_or_path)
    what = f"a scenario file or one of {', '.join(shipped())}"
    scenario, _ = load_toml(Scenario, path, overrides, context={}, error=ScenarioError, what=what)
    return scenario
