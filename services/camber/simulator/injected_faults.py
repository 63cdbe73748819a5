"""What goes wrong in a simulated drive, when and by how much, and what that does to signals and to a vehicle.

Each fault's onset and end stand in the truth. Times are seconds after the first epoch. A fault acts from its onset
(inclusive) to its end (exclusive); without an end, to the end of the drive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal, Self, TypeVar

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.schemas.base import Model
from camber.schemas.channels import SERVICES
from camber.simulator.scene import Booleans, Floats, Integers

Metres = Annotated[float, Field(ge=-1_000.0, le=1_000.0)]
MetresPerSecond = Annotated[float, Field(ge=-10.0, le=10.0)]
_LAST_S = 86_400.0  # the latest time of a schedule
_JAMMING_RAMP_S = 2.0  # chosen: a jammer comes nearer and goes away
_RAMP_S = 0.5  # chosen: a fault of the vehicle is no jolt


class _Scheduled(Model):
    onset_s: float = Field(ge=0.0, le=86_400.0, description="from here, seconds")
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
        return (time_s >= self.onset_s) & (time_s < end_s)


class WrongBase(_Scheduled):
    """The base station's coordinates are wrong: all fixes are off alike."""

    kind: Literal["wrong_base"]
    east_m: Metres = 0.0
    north_m: Metres = 0.0
    up_m: Metres = 0.0


class WrongMap(_Scheduled):
    """The map's heights are wrong by this much where the vehicle drives in this time."""

    kind: Literal["wrong_map"]
    offset_m: float = Field(ge=-10.0, le=10.0, description="map less road, metres")


class ChangedRoad(_Scheduled):
    """The road has been raised or lowered since the survey where the vehicle drives in this time."""

    kind: Literal["changed_road"]
    offset_m: float = Field(ge=-0.5, le=0.5, description="road now less road then, metres")


class ChangedTyre(_Scheduled):
    """Another tyre, or one that loses air."""

    kind: Literal["changed_tyre"]
    radius_change_m: float = Field(ge=-0.1, le=0.1, description="metres")


class ChangedLoad(_Scheduled):
    """The vehicle is loaded: the suspension sinks, the tyres too."""

    kind: Literal["changed_load"]
    load_kg: float = Field(ge=0.0, le=2_000.0, description="kilograms in the boot")


class WheelSlip(_Scheduled):
    """The wheels turn faster than the vehicle drives, or slide."""

    kind: Literal["wheel_slip"]
    factor: float = Field(ge=0.0, le=3.0, description="wheel speed by speed over ground")


class BlockedLidar(_Scheduled):
    """Something hides a part of the surround sensor's view."""

    kind: Literal["blocked_lidar"]
    share: float = Field(gt=0.0, le=1.0, description="of its directions")


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
    loss_db: float = Field(gt=0.0, le=60.0, description="of C/N0")


class TimeJump(_Scheduled):
    """The receiver's clock is off by this much."""

    kind: Literal["time_jump"]
    offset_s: float = Field(ge=-86_400.0, le=86_400.0, description="receiver less GPS time")


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


AMOUNTS: dict[type[ChangedTyre | ChangedLoad | WheelSlip], tuple[str, float]] = {
    ChangedTyre: ("radius_change_m", 0.0),
    ChangedLoad: ("load_kg", 0.0),
    WheelSlip: ("factor", 1.0),
}
"""Of the kinds that add up while they act together: the field that is the amount, and the value that does nothing."""


def refused_sum(faults: tuple[Fault, ...]) -> str | None:
    """Where several of one kind act at once the vehicle feels their sum: the error in it, or None.

    The sum keeps the limits of a single one, which leave every tyre a radius.
    """
    for kind, (name, none) in AMOUNTS.items():
        of_this_kind = of_kind(faults, kind)
        at_least, at_most = kind.model_fields[name].metadata
        least, most = at_least.ge, at_most.le
        edges = {time_s for f in of_this_kind for time_s in (f.onset_s, f.end_s) if time_s is not None}
        for at_s in sorted(edges):
            acting = [f for f in of_this_kind if f.acts(np.array([at_s]))[0]]
            together = none + sum(getattr(f, name) - none for f in acting)
            if not least - 1e-9 <= together <= most + 1e-9:
                acts = f"{len(acting)} {acting[0].kind} act at {at_s:g} s with {name} {together:.6g} together"
                return f"{acts}, expected {least:g} to {most:g}"
    return None


def _span_ns(fault: Jamming | Spoofing, time_ns: Integers) -> tuple[int, int]:
    end_s = _LAST_S if fault.end_s is None else fault.end_s
    begin_ns, end_ns = (int(time_ns[0]) + round(s * NS_PER_SECOND) for s in (fault.onset_s, end_s))
    return begin_ns, end_ns


def cn0_loss_db(faults: Sequence[Fault], time_ns: Integers) -> Floats:
    """How much jamming takes from C/N0 of all signals (n,), over two seconds at each end.

    Onsets count from the first of the times; a fault without an end lasts beyond the last.
    """
    loss = np.zeros(len(time_ns))
    for fault in of_kind(faults, Jamming):
        begin_ns, end_ns = _span_ns(fault, time_ns)
        inside_s = np.minimum(time_ns - begin_ns, end_ns - time_ns) / NS_PER_SECOND
        loss += fault.loss_db * np.clip(inside_s / _JAMMING_RAMP_S, 0.0, 1.0)
    return loss


def antenna_offset_m(faults: Sequence[Fault], time_ns: Integers) -> tuple[Floats, Floats]:
    """How far (n, 3) [m] off the true antenna spoofed signals put it, and how fast [m/s]; it comes back at the end."""
    offset, rate = np.zeros((2, len(time_ns), 3))
    for fault in of_kind(faults, Spoofing):
        begin_ns, end_ns = _span_ns(fault, time_ns)
        drift_m_s = np.array((fault.east_m_s, fault.north_m_s, fault.up_m_s))
        on = (time_ns >= begin_ns) & (time_ns < end_ns)
        offset += np.where(on, (time_ns - begin_ns) / NS_PER_SECOND, 0.0)[:, None] * drift_m_s
        rate += on[:, None] * drift_m_s
    return offset, rate


def vehicle_effect(
    faults: Sequence[Fault], kind: type[ChangedTyre | ChangedLoad | WheelSlip], time_s: Floats
) -> tuple[Floats, Floats]:
    """The sum of all faults of a kind at times (n,) since the beginning, and its derivative by time.

    Metres by which all tyres' radius is greater, kilograms in the boot, or the share by which the wheels turn faster
    than they roll. Comes and goes over half a second, within onset and end; ValueError where that does not fit.
    """
    field, none = AMOUNTS[kind]
    value, rate = np.zeros(len(time_s)), np.zeros(len(time_s))
    for fault in of_kind(faults, kind):
        amount, end_s = getattr(fault, field) - none, math.inf if fault.end_s is None else fault.end_s
        if not end_s - fault.onset_s >= 2.0 * _RAMP_S:
            raise ValueError(f"{fault.kind}: end_s is {end_s}, expected two ramps after {fault.onset_s}")
        for sign, start_s in ((1.0, fault.onset_s), (-1.0, end_s - _RAMP_S)):
            share = np.clip((time_s - start_s) / _RAMP_S, 0.0, 1.0)
            value += sign * amount * share**2 * (3.0 - 2.0 * share)
            rate += sign * amount * 6.0 * share * (1.0 - share) / _RAMP_S
    return value, rate
