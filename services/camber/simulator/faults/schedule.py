"""What goes wrong in a simulated drive, when and by how much; each fault's onset and end stand in the truth.

Times are seconds after the first epoch. A fault acts from its onset (inclusive) to its end (exclusive); without an
end, to the end of the drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from camber.schemas.base import Model
from camber.schemas.channels import SERVICES
from camber.simulator.scene import Booleans, Floats

Metres = Annotated[float, Field(ge=-1_000.0, le=1_000.0)]
MetresPerSecond = Annotated[float, Field(ge=-10.0, le=10.0)]
_LIMITS = {"radius_change_m": (-0.1, 0.1), "load_kg": (0.0, 2_000.0), "factor": (0.0, 3.0)}


def _limited(name: str, description: str) -> Any:
    least, most = _LIMITS[name]
    return Field(ge=least, le=most, description=description)


class _Scheduled(Model):
    onset_s: Annotated[float, Field(ge=0.0, le=86_400.0)] = Field(description="from here, seconds")
    end_s: Annotated[float, Field(gt=0.0, le=86_400.0)] | None = Field(
        default=None, description="to here, seconds; unset: to the end"
    )

    @model_validator(mode="after")
    def _ends_after_its_onset(self) -> Self:
        if self.end_s is not None and self.end_s <= self.onset_s:
            raise PydanticCustomError("order", "end_s is not after onset_s, expected a later time")
        return self

    def acts(self, time_s: Floats) -> Booleans:
        """At which of these times it acts."""
        end_s = np.inf if self.end_s is None else self.end_s
        acts: Booleans = (time_s >= self.onset_s) & (time_s < end_s)
        return acts


class WrongBase(_Scheduled):
    """The base station's coordinates are wrong: all fixes are off alike."""

    kind: Literal["wrong_base"]
    east_m: Metres = 0.0
    north_m: Metres = 0.0
    up_m: Metres = 0.0


class WrongMap(_Scheduled):
    """The map's heights are wrong by this much where the vehicle drives in this time."""

    kind: Literal["wrong_map"]
    offset_m: Annotated[float, Field(ge=-10.0, le=10.0)] = Field(description="map less road, metres")


class ChangedRoad(_Scheduled):
    """The road has been raised or lowered since the survey where the vehicle drives in this time."""

    kind: Literal["changed_road"]
    offset_m: Annotated[float, Field(ge=-0.5, le=0.5)] = Field(description="road now less road then, metres")


class ChangedTyre(_Scheduled):
    """Another tyre, or one that loses air."""

    kind: Literal["changed_tyre"]
    radius_change_m: float = _limited("radius_change_m", "metres")


class ChangedLoad(_Scheduled):
    """The vehicle is loaded: the suspension sinks, the tyres too."""

    kind: Literal["changed_load"]
    load_kg: float = _limited("load_kg", "kilograms in the boot")


class WheelSlip(_Scheduled):
    """The wheels turn faster than the vehicle drives, or slide."""

    kind: Literal["wheel_slip"]
    factor: float = _limited("factor", "wheel speed by speed over ground")


class BlockedLidar(_Scheduled):
    """Something hides a part of the surround sensor's view."""

    kind: Literal["blocked_lidar"]
    share: Annotated[float, Field(gt=0.0, le=1.0)] = Field(description="of its directions")


class SymmetricScene(_Scheduled):
    """The surround sensor sees the road only, as between featureless walls."""

    kind: Literal["symmetric_scene"]


class Spoofing(_Scheduled):
    """A counterfeit sky leads the receiver away, slowly."""

    kind: Literal["spoofing"]
    east_m_s: MetresPerSecond = 0.0
    north_m_s: MetresPerSecond = 0.0
    up_m_s: MetresPerSecond = 0.0


class Jamming(_Scheduled):
    """Noise drowns the satellites."""

    kind: Literal["jamming"]
    loss_db: Annotated[float, Field(gt=0.0, le=60.0)] = Field(description="of C/N0")


class TimeJump(_Scheduled):
    """The receiver's clock is off by this much."""

    kind: Literal["time_jump"]
    offset_s: Annotated[float, Field(ge=-86_400.0, le=86_400.0)] = Field(description="receiver less GPS time")


class RepeatedEpochs(_Scheduled):
    """The receiver sends each epoch twice."""

    kind: Literal["repeated_epochs"]


class MissingEpochs(_Scheduled):
    """The receiver sends nothing."""

    kind: Literal["missing_epochs"]


class DroppedProcess(_Scheduled):
    """A service of the vehicle is killed at the onset: in the manifest, for the replay to do."""

    kind: Literal["dropped_process"]
    service: Literal["gnss", "map_server", "antenna_height", "localizer", "integrity", "map_update"] = Field(
        description="one of " + ", ".join(SERVICES)
    )

    @model_validator(mode="after")
    def _has_no_end(self) -> Self:
        if self.end_s is not None:
            text = "a process that dropped is started again at once, expected no end_s"
            raise PydanticCustomError("end", text)
        return self

    def acts(self, time_s: Floats) -> Booleans:
        """At the first of these times that is not before its onset."""
        acts: Booleans = np.arange(len(time_s)) == np.searchsorted(time_s, self.onset_s)
        return acts


_OfDrive = WrongMap | ChangedRoad | ChangedTyre | ChangedLoad | WheelSlip | BlockedLidar | SymmetricScene
_OfReceiver = WrongBase | Spoofing | Jamming | TimeJump | RepeatedEpochs | MissingEpochs
Fault = Annotated[_OfDrive | _OfReceiver | DroppedProcess, Field(discriminator="kind")]

F = TypeVar("F", bound=_Scheduled)


def of_kind(faults: Sequence[Fault], kind: type[F]) -> tuple[F, ...]:
    """Those of one kind, in their order."""
    return tuple(fault for fault in faults if isinstance(fault, kind))


def until(faults: Sequence[Fault], duration_s: float) -> list[Fault]:
    """The same, but those that have no end end with the drive."""
    return [f if f.end_s is not None else f.model_copy(update={"end_s": duration_s}) for f in faults]


def refused_sum(faults: tuple[Fault, ...]) -> str | None:
    """Where several of one kind act at once the vehicle feels their sum: the error in it, or None.

    The sum keeps the limits of a single one, which leave every tyre a radius.
    """
    for kind, name, normal in (
        ("changed_tyre", "radius_change_m", 0.0),
        ("changed_load", "load_kg", 0.0),
        ("wheel_slip", "factor", 1.0),
    ):
        of_this_kind = [fault for fault in faults if fault.kind == kind]
        least, most = _LIMITS[name]
        edges = {time_s for f in of_this_kind for time_s in (f.onset_s, f.end_s) if time_s is not None}
        for at_s in sorted(edges):
            acting = [f for f in of_this_kind if f.acts(np.array([at_s]))[0]]
            together = normal + sum(getattr(f, name) - normal for f in acting)
            if not least - 1e-9 <= together <= most + 1e-9:
                acts = f"{len(acting)} {kind} act at {at_s:g} s with {name} {together:.6g} together"
                return f"{acts}, expected {least:g} to {most:g}"
    return None
