"""The drive manifest, `drive.toml`: one description of a recorded drive in its native files.

A path is absolute, relative to the manifest, or begins with `${CAMBER_DATA}`, the folder of recordings. What a
recording has not got may be made from its truth: such an input is a *surrogate*, is named in `surrogates.inputs`, and
is named again in the summary of every figure that rests on it. `docs/drive.md` explains the file for people.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast, get_args

from pydantic import BeforeValidator, Field, PrivateAttr, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from camber.schemas.base import Model, Name, Text
from camber.schemas.integrity import HorizontalReference
from camber.schemas.map_errors import COMMON_OFFSET_SIGMA_M, LONG_M, SHORT_M, SHORT_SHARE
from camber.schemas.motion import LeverArm, MountedImu
from camber.schemas.toml_file import FileError, Overrides, load_toml

SurrogateInput = Literal["wheel_speed", "yaw_rate", "steering", "links", "road_surfaces", "initial_pose"]
MOTION_SURROGATES = frozenset({"wheel_speed", "yaw_rate", "steering"})
MAP_SURROGATES = frozenset({"links", "road_surfaces"})


class ManifestError(FileError):
    """The manifest cannot be used; one clear line with the file, the field and what was expected."""


def _native(value: Any, info: ValidationInfo) -> Path:
    """The path a manifest means, by the folder and environment in the validation context."""
    if not isinstance(value, str) or not value:
        raise PydanticCustomError("path", "expected a path as text")
    context: Mapping[str, Any] = info.context or {"folder": Path(), "environ": os.environ}
    first, _, rest = value.partition("/")
    if first == "${CAMBER_DATA}":
        data = context["environ"].get("CAMBER_DATA")
        if not data:
            raise PydanticCustomError(
                "path", "CAMBER_DATA is not set, expected the folder of recordings in it"
            )
        return Path(data) / rest
    if "$" in value:
        raise PydanticCustomError("path", "expected a path without $, or ${CAMBER_DATA} as its first part")
    return Path(context["folder"]) / value


def _native_file(value: Any, info: ValidationInfo) -> Path:
    path = _native(value, info)
    if not path.is_file():
        raise PydanticCustomError("path", "there is no such file: {path}", {"path": str(path.absolute())})
    return path


def _native_folder(value: Any, info: ValidationInfo) -> Path:
    path = _native(value, info)
    if not path.is_dir():
        raise PydanticCustomError("path", "there is no such folder: {path}", {"path": str(path.absolute())})
    return path


File = Annotated[Path, BeforeValidator(_native_file)]
Folder = Annotated[Path, BeforeValidator(_native_folder)]
Metres = Annotated[float, Field(ge=-100.0, le=100.0)]
EcefMetres = Annotated[float, Field(ge=-1e7, le=1e7)]
ErrorMetres = Annotated[float, Field(gt=0.0, le=1_000.0)]


class ReceiverFile(Model):
    """What the receiver solved by itself."""

    format: Literal["pos", "nmea"] = Field(description="format of the file, pos (RTKLIB) or nmea")
    file: File = Field(description="file of solutions as the receiver or its program wrote it")
    utc_date: date | None = Field(
        None, description="UTC date of the first NMEA position, if the file has none"
    )
    arrivals: File | None = Field(
        None, description="CSV file that says when each part of file arrived, as in docs/drive.md"
    )


class RawObservations(Model):
    """Raw observations for Camber's own engine; each file may be packed with gzip."""

    rover_obs: File = Field(description="observations of the vehicle's antenna (RINEX, UBX, SBF or RTCM 3)")
    rover_arrivals: File | None = Field(
        None, description="CSV file that says when each part of rover_obs arrived"
    )
    base_obs: File = Field(description="observations of the base station")
    base_arrivals: File | None = Field(None, description="the same for base_obs")
    ephemerides: Annotated[tuple[File, ...], Field(strict=False, min_length=1)] = Field(
        description="files of broadcast ephemerides"
    )
    base_ecef_m: Annotated[tuple[EcefMetres, EcefMetres, EcefMetres], Field(strict=False)] | None = Field(
        None, description="where the base's antenna is, ECEF; unset: as base_obs itself says"
    )
    ambiguities: Literal["single_epoch", "carried"] = Field(
        "single_epoch", description="of each epoch alone, or carried along unbroken arcs from epoch to epoch"
    )


class SampleFile(Model):
    """A table of samples in Camber's CSV layout (`camber.formats.drive.motion_csv`)."""

    file: File = Field(description="CSV file, its columns as in docs/drive.md")


class ImuFile(MountedImu):
    """Samples of an inertial measurement unit, and how it is mounted."""

    file: File = Field(description="CSV file, its columns as in docs/drive.md")


class Sweeps(Model):
    """Sweeps of a surround sensor."""

    folder: Folder = Field(description="folder with one point-cloud file a sweep")


class MapRelease(Model):
    """The map the vehicle drives with."""

    release: Folder = Field(description="folder of a map release")


class Truth(Model):
    """Where the antenna really was. Used to judge, and to make surrogates from; never an input of a service."""

    format: Literal["camber", "nagoya"] = Field(description="layout of the file, camber or nagoya")
    file: File = Field(description="CSV file of positions, attitudes and velocities")
    receiver_minus_truth_east_m: Metres = Field(
        0.0, description="constant offset of right fixes from the truth (datum, antenna point), to the east"
    )
    receiver_minus_truth_north_m: Metres = Field(0.0, description="the same, to the north")
    receiver_minus_truth_up_m: Metres = Field(0.0, description="the same, upwards")


class LeverArms(Model):
    """Where things are on the vehicle."""

    antenna: LeverArm = Field(LeverArm(), description="reference point of the antenna")
    lidar: LeverArm = Field(LeverArm(), description="origin of the surround sensor")
    wheel: LeverArm = Field(LeverArm(), description="point whose speed the wheel sensor gives")
    ranging: LeverArm | None = Field(None, description="origin of the ranging sensor")
    suspension: LeverArm | None = Field(None, description="top of the suspension whose stroke is measured")

    @property
    def with_given_height(self) -> dict[str, LeverArm]:
        """Return the lever arms whose height above the road is given in the manifest, by name."""
        arms = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: arm for name, arm in arms.items() if arm is not None and "z_m" in arm.model_fields_set}


class AntennaHeightMethod(Model):
    """Road surface to antenna, and how it is known (JP7707657B2, third embodiment)."""

    way: Literal["fixed", "stroke", "ranging", "scan_matching", "automatic"] = Field(
        "fixed", description="how the antenna's height is found"
    )
    height_m: Annotated[float, Field(ge=-1.0, le=100.0)] | None = Field(
        None, description="fixed: road surface to antenna"
    )
    sigma_m: Annotated[float, Field(gt=0.0, le=10.0)] | None = Field(
        None, description="fixed: standard deviation of height_m"
    )
    suspension_to_antenna_m: Metres | None = Field(None, description="stroke: h_ba of JP7707657B2 eq. (1)")
    tyre_radius_m: Annotated[float, Field(gt=0.0, le=5.0)] | None = Field(
        None, description="stroke: h_t of JP7707657B2 eq. (1)"
    )
    beam_azimuth_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = Field(
        0.0, description="ranging: where the beam points, counter-clockwise from forward"
    )

    @model_validator(mode="after")
    def _complete(self) -> Self:
        needed = {
            "fixed": ("height_m", "sigma_m"),
            "stroke": ("suspension_to_antenna_m", "tyre_radius_m"),
        }.get(self.way, ())
        for name in needed:
            if getattr(self, name) is None:
                raise PydanticCustomError("incomplete", f"way = {self.way!r} without {name}, expected both")
        return self


_SENSORS = {
    "ranging": "a table ranging or a table sweeps",
    "scan_matching": "a table sweeps",
    "automatic": "a table ranging or a table sweeps",
}
"""What a method measures with."""


class InitialPose(Model):
    """Where the antenna is at the start of the drive, known without satellites: a parking place, an operator."""

    latitude_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = Field(description="latitude of the antenna")
    longitude_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = Field(
        description="longitude of the antenna"
    )
    yaw_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = Field(
        description="direction of the vehicle's x, counter-clockwise from east"
    )
    horizontal_sigma_m: ErrorMetres = Field(description="standard deviation in east and in north")
    yaw_sigma_deg: Annotated[float, Field(gt=0.0, le=180.0)] = Field(
        description="standard deviation of yaw_deg"
    )


class Kill(Model):
    """A process that dies on the way, by SIGKILL; the replay starts it again as it does any other that ends."""

    service: Literal["gnss", "map_server", "antenna_height", "localizer", "integrity", "map_update"] = Field(
        description="which"
    )
    at_s: Annotated[float, Field(ge=0.0, le=1e6)] = Field(description="seconds after the drive's first epoch")


def _error(least: float, description: str, *, most: float, default: float | None = None) -> Any:
    """The size of an error; `least` (and default): the least on which a published figure may rest."""
    size = least if default is None else default
    return Field(size, gt=0.0, le=most, description=description, json_schema_extra={"least": least})


def _angle(least_deg: float, description: str, *, default_deg: float | None = None) -> Any:
    default = math.radians(least_deg if default_deg is None else default_deg)
    return _error(math.radians(least_deg), description, most=math.pi, default=default)


class Surrogates(Model):
    """Which inputs are made from the truth, and with what errors; an error once drawn holds for the whole drive
    where its name has `bias`, `scale` or `deviation`."""

    allow_smaller_errors: bool = Field(False, description="true or false; true is shown in every summary")
    inputs: Annotated[tuple[SurrogateInput, ...], Field(strict=False)] = Field(
        (), description="list of " + ", ".join(get_args(SurrogateInput))
    )
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(1, description="seed of all errors, a whole number")
    wheel_scale_sigma: float = _error(
        0.005, "relative standard deviation of the wheel's scale error", most=0.5
    )
    wheel_noise_m_s: float = _error(0.05, "white noise of the wheel speed, in m/s", most=10.0)
    yaw_rate_bias_sigma_rad_s: float = _angle(0.02, "standard deviation of the yaw rate's bias, rad/s")
    yaw_rate_noise_rad_s: float = _angle(0.1, "white noise of the yaw rate, rad/s")
    steering_bias_sigma_rad: float = _angle(0.2, "standard deviation of the steering's bias, rad")
    steering_noise_rad: float = _angle(0.2, "white noise of the steering angle, rad")
    wheelbase_m: Annotated[float, Field(gt=0.1, le=20.0)] = Field(
        2.7, description="wheelbase of the bicycle model that steering is made with, metres"
    )
    link_deviation_m: float = _error(3.0, "how far links run off the track at most, metres", most=50.0)
    map_sigma_m: float = _error(
        0.05, "standard deviation of the road's elevation along the road, metres", most=10.0
    )
    map_short_share: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        SHORT_SHARE, description="share of the short part in the variance of that error"
    )
    map_short_m: Annotated[float, Field(gt=0.0, le=100_000.0)] = Field(
        SHORT_M, description="correlation length of the short part (first-order Gauss–Markov), metres"
    )
    map_long_m: float = _error(
        LONG_M, "correlation length of the long part (second-order Gauss–Markov), metres", most=100_000.0
    )
    map_common_offset_sigma_m: float = _error(
        COMMON_OFFSET_SIGMA_M, "standard deviation of what all elevations have in common, metres", most=10.0
    )
    antenna_height_m: Annotated[float, Field(ge=-1.0, le=100.0)] | None = Field(
        None,
        description="what is taken from the truth's heights to make roads, metres; unset: antenna_height.height_m",
    )
    initial_pose_sigma_m: float = _error(1.0, "error of the given pose, east and north, metres", most=1000.0)
    initial_yaw_sigma_rad: float = _angle(1.0, "error of the given pose's direction, rad", default_deg=2.0)

    @field_validator("*")
    @classmethod
    def _not_too_good(cls, value: Any, info: ValidationInfo) -> Any:
        least = LEAST_ERRORS.get(str(info.field_name))
        if least is not None and value < least and not info.data.get("allow_smaller_errors", False):
            raise PydanticCustomError(
                "too_good", f"expected at least {least:.6g}, or surrogates.allow_smaller_errors = true"
            )
        return value

    @field_validator("inputs")
    @classmethod
    def _each_once(cls, value: tuple[SurrogateInput, ...]) -> tuple[SurrogateInput, ...]:
        if len(set(value)) != len(value):
            raise PydanticCustomError("repeated", "expected each input once")
        return value

    @property
    def smaller_errors(self) -> tuple[str, ...]:
        """The errors that are below what a published figure may rest on."""
        return tuple(name for name, least in LEAST_ERRORS.items() if getattr(self, name) < least)


LEAST_ERRORS: dict[str, float] = {
    name: cast(float, info.json_schema_extra["least"])
    for name, info in Surrogates.model_fields.items()
    if isinstance(info.json_schema_extra, dict)
}
"""A surrogate made from truth flatters its user; no published figure may rest on smaller errors than these."""


class DriveManifest(Model):
    """One drive. Paths are resolved and exist; angles are in radians unless the name says degrees."""

    name: Name = Field(description="name of the drive: letters, digits and _ . : @ + -")
    description: Text = Field("", description="where it comes from, for people")
    vehicle: Name = Field("vehicle", description="name of the vehicle, second part of every key")
    datum: Name = Field("WGS84", description="datum of all positions and ellipsoidal heights")
    simulated: bool = Field(False, description="true where all of it comes from a simulator")
    alert_limit_m: Annotated[float, Field(gt=0.0, le=1_000.0)] = Field(
        1.5, description="horizontal alert limit, metres"
    )
    horizontal_reference: HorizontalReference = Field(
        "required",
        description="the judge's setting: a position that rests on no fix, or honest base and signals",
    )
    start_s: Annotated[float, Field(ge=0.0, le=1e6)] | None = Field(
        None, description="leave out what comes earlier, seconds after the first epoch of the files"
    )
    end_s: Annotated[float, Field(gt=0.0, le=1e6)] | None = Field(
        None, description="leave out what comes later, seconds after the first epoch of the files"
    )
    receiver: ReceiverFile | None = Field(None, description="table with the receiver's own solutions")
    observations: RawObservations | None = Field(None, description="table with raw observations and a base")
    positions: Literal["receiver", "engine"] | None = Field(
        None,
        description="whose positions are judged, receiver or engine; unset: the receiver's where there are some",
    )
    motion: SampleFile | None = Field(None, description="table with wheel speed, yaw rate and steering")
    imu: ImuFile | None = Field(
        None, description="table with an inertial measurement unit's samples and mounting"
    )
    suspension: SampleFile | None = Field(None, description="table with stroke heights")
    ranging: SampleFile | None = Field(None, description="table with distances to the road")
    sweeps: Sweeps | None = Field(None, description="table with the sweeps' folder")
    map: MapRelease | None = Field(None, description="table with the map release")
    truth: Truth | None = Field(None, description="table with the truth")
    lever_arms: LeverArms = Field(LeverArms(), description="table of places on the vehicle")
    antenna_height: AntennaHeightMethod | None = Field(
        None, description="table that says how the antenna's height is known; without it no fix is confirmed"
    )
    initial_pose: InitialPose | None = Field(None, description="table with a given pose at the start")
    kills: Annotated[tuple[Kill, ...], Field(strict=False)] = Field(
        (), max_length=64, description="list of services that are killed during a replay, and when"
    )
    surrogates: Surrogates = Field(Surrogates(), description="table of inputs made from the truth")
    _overrides: tuple[str, ...] = PrivateAttr(default=())

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        problem = next(iter(self._problems()), None)
        if problem is not None:
            raise PydanticCustomError("inconsistent", problem)
        return self

    def _problems(self) -> list[str]:
        inputs = frozenset(self.surrogates.inputs)
        height = self.antenna_height
        method = "" if height is None else height.way
        roads_without_height = self.surrogates.antenna_height_m is None and (
            height is None or height.height_m is None
        )
        measured = (
            *(self.receiver, self.observations, self.motion, self.imu),
            *(self.suspension, self.ranging, self.sweeps),
        )
        tests = {
            "receiver: expected one of the tables receiver, observations, motion, imu, suspension, ranging, sweeps": (
                all(table is None for table in measured) and not inputs & MOTION_SURROGATES
            ),
            f"positions is {self.positions!r}, expected a table with them": (
                (self.positions == "receiver" and self.receiver is None)
                or (self.positions == "engine" and self.observations is None)
            ),
            "surrogates.inputs is not empty, expected a table truth to make them from": bool(
                inputs and self.truth is None
            ),
            "motion.file is given, expected no wheel_speed, yaw_rate, steering in surrogates.inputs": bool(
                inputs & MOTION_SURROGATES and self.motion is not None
            ),
            "map.release is given, expected no links, road_surfaces in surrogates.inputs": bool(
                inputs & MAP_SURROGATES and self.map is not None
            ),
            "initial_pose is given, expected no initial_pose in surrogates.inputs": (
                "initial_pose" in inputs and self.initial_pose is not None
            ),
            "antenna_height.way is 'stroke', expected a table suspension": method == "stroke"
            and self.suspension is None,
            f"antenna_height.way is {method!r}, expected lever_arms.antenna with its z_m": (
                method in _SENSORS and "antenna" not in self.lever_arms.with_given_height
            ),
            f"antenna_height.way is {method!r}, expected {_SENSORS.get(method)}, each with its lever arm and z_m": (
                method in _SENSORS and not self._has_sensor(method)
            ),
            "surrogates.antenna_height_m is missing, expected it where antenna_height has no height_m": (
                "road_surfaces" in inputs and roads_without_height
            ),
            "initial_pose is that of the drive's first epoch, expected no start_s": (
                self.initial_pose is not None and bool(self.start_s)
            ),
            "end_s is not after start_s, expected a later time": (
                self.end_s is not None and self.start_s is not None and self.end_s <= self.start_s
            ),
        }
        return [text for text, failed in tests.items() if failed]

    def _has_sensor(self, method: str) -> bool:
        """Return whether a sensor for this method is configured; sweeps show the road near the vehicle, too."""
        given = self.lever_arms.with_given_height
        sweeps = self.sweeps is not None and "lidar" in given
        return sweeps or (method != "scan_matching" and self.ranging is not None and "ranging" in given)

    @property
    def judged_positions(self) -> Literal["receiver", "engine"]:
        """Whose positions are judged."""
        only_raw = self.receiver is None and self.observations is not None
        return self.positions or ("engine" if only_raw else "receiver")

    @property
    def overrides(self) -> tuple[str, ...]:
        """What was changed from the file, as `field=value`."""
        return self._overrides

    def surrogate_notes(self) -> tuple[str, ...]:
        """One line for each input that was made and not measured, and with what errors; for reports."""
        e = self.surrogates
        degrees = {
            name: f"{math.degrees(getattr(e, name)):.3g}"
            for name in type(e).model_fields
            if name.endswith(("_rad", "_rad_s"))
        }
        how = {
            "wheel_speed": f"scale error {e.wheel_scale_sigma:g}, noise {e.wheel_noise_m_s:g} m/s",
            "yaw_rate": f"bias {degrees['yaw_rate_bias_sigma_rad_s']}, noise {degrees['yaw_rate_noise_rad_s']} °/s",
            "steering": f"bias {degrees['steering_bias_sigma_rad']}, noise {degrees['steering_noise_rad']}°",
            "links": f"up to {e.link_deviation_m:g} m off the track",
            "road_surfaces": (
                f"noise {e.map_sigma_m:g} m, correlated over {e.map_short_m:g} m ({e.map_short_share:.3g} of its "
                f"variance) and {e.map_long_m:g} m, common offset of σ {e.map_common_offset_sigma_m:g} m"
            ),
            "initial_pose": f"off by {e.initial_pose_sigma_m:g} m, {degrees['initial_yaw_sigma_rad']}°",
        }
        notes = [f"{name}: made from the truth, {how[name]} (seed {e.seed})" for name in e.inputs]
        if e.allow_smaller_errors:
            smaller = ", ".join(e.smaller_errors) or "none"
            notes.append(
                f"smaller errors than a published figure may rest on are allowed; they are: {smaller}"
            )
        return tuple(notes)

    def summary(self) -> dict[str, Any]:
        """What every report of this drive says of it; without paths, so it is the same on every machine."""
        inputs = self.surrogates.inputs
        summary: dict[str, Any] = {
            "drive": self.name,
            "vehicle": self.vehicle,
            "simulated": self.simulated,
            "surrogates": list(inputs),
            "alert_limit_m": self.alert_limit_m,
            "horizontal_reference": self.horizontal_reference,
            "start_s": self.start_s,
            "end_s": self.end_s,
            "overrides": list(self.overrides),
        }
        if inputs:
            summary["surrogate_errors"] = {
                name: getattr(self.surrogates, name) for name in ("seed", *LEAST_ERRORS)
            }
        if self.surrogates.allow_smaller_errors:
            summary["allow_smaller_errors"] = True
            summary["smaller_errors"] = list(self.surrogates.smaller_errors)
        return summary


def load_manifest(
    path: Path, overrides: Overrides = (), *, environ: Mapping[str, str] | None = None
) -> DriveManifest:
    """Read a manifest; raises ManifestError with one line. `environ` stands for the process's environment in tests."""
    context = {"folder": path.parent, "environ": os.environ if environ is None else environ}
    manifest, changes = load_toml(
        DriveManifest, path, overrides, context=context, error=ManifestError, what="a drive manifest"
    )
    manifest._overrides = changes
    return manifest
