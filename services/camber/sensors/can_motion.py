"""Signals of a CAN bus → motion and suspension strokes.

One message of the bus, as a rule that with the yaw rate, makes a Motion each time it comes; the other quantities are
the newest by then. What is older than `oldest_s`, marked as invalid, beyond the range that the DBC file gives, or not
there at all is None.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from camber.formats.lidar_can.candump import CanFrame
from camber.formats.lidar_can.dbc import DbcMessage, DbcSignal, read_dbc
from camber.schemas.base import Message
from camber.schemas.motion import Motion, Suspension
from camber.sensors.sources import can_source, checked_by, text_of
from camber.sensors.units import UNITS, Quantity, Unit, spelt

CanQuantity = Literal[
    "wheel_speed", "yaw_rate", "steering_angle", "pitch", "roll", "stroke_height", "reverse_gear"
]
QUANTITIES: dict[CanQuantity, tuple[Quantity, str | None]] = {
    "wheel_speed": ("speed", "wheel_speed_m_s"),
    "yaw_rate": ("turn rate", "yaw_rate_rad_s"),
    "steering_angle": ("angle", "steering_angle_rad"),
    "pitch": ("angle", "pitch_rad"),
    "roll": ("angle", "roll_rad"),
    "stroke_height": ("length", None),
    "reverse_gear": ("code", None),
}
"""What each measures, and its field of a Motion."""
_FIELDS = {name: field for name, (_, field) in QUANTITIES.items() if field is not None}


class SignalError(ValueError):
    """A signal cannot be what the settings say; one clear line."""


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

    source: Annotated[str, AfterValidator(checked_by(can_source))] | None = Field(
        None, description="socketcan:INTERFACE or candump:FILE; unset: none"
    )
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

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if self.source is not None:
            self.reader()
        return self

    def signals(self) -> dict[CanQuantity, SignalSettings]:
        """Those that the vehicle has."""
        return {name: one for name in QUANTITIES if (one := getattr(self, name)).signal is not None}

    def reader(self) -> CanMotion:
        """The signals that are described here. Raises ValueError where something is missing or does not fit."""
        signals = self.signals()
        if self.dbc is None:
            raise ValueError("dbc: missing; the bus cannot be read without")
        if not signals.keys() - {"reverse_gear"}:
            raise ValueError("wheel_speed, yaw_rate …: missing; expected at least one signal")
        if "reverse_gear" in signals and not self.reverse_codes:
            raise ValueError("reverse_codes: missing; which values of reverse_gear mean backwards?")
        if "reverse_gear" in signals and not self.forward_codes:
            raise ValueError("forward_codes: missing; which values of reverse_gear mean forwards?")
        if both := set(self.reverse_codes) & set(self.forward_codes):
            raise ValueError(f"forward_codes: {min(both)} is in reverse_codes too")
        return CanMotion(read_dbc(text_of(self.dbc, "cp1252"), self.dbc.name), self)


@dataclass(frozen=True, slots=True, kw_only=True)
class _SignalReading:
    """A signal with its conversion."""

    name: CanQuantity
    signal: DbcSignal
    factor: float
    invalid: frozenset[int]


class CanMotion:
    """Motion out of frames. Raises SignalError where a signal is not in the DBC file, or is of another unit."""

    def __init__(self, messages: Mapping[str, DbcMessage], settings: CanSettings) -> None:
        self.counts: Counter[str] = Counter()
        self._settings, self._oldest_ns = settings, round(settings.oldest_s * 1e9)
        reverse, forward = settings.reverse_codes, settings.forward_codes
        self._signs = dict.fromkeys(forward, 1.0) | dict.fromkeys(reverse, -1.0)
        self._readings: dict[tuple[int, bool], list[_SignalReading]] = {}
        self._values: dict[CanQuantity, tuple[int, float | None]] = {}  # time and value
        self._message_of: dict[CanQuantity, DbcMessage] = {}
        for name, use in settings.signals().items():
            message, reading = _reading(messages, name, use)
            self._readings.setdefault((message.identifier, message.extended), []).append(reading)
            self._message_of[name] = message
            if name == "reverse_gear":
                _check_codes("reverse_codes", reading.signal, reverse)
                _check_codes("forward_codes", reading.signal, forward)
        trigger = settings.trigger
        if trigger is not None and trigger not in messages:
            raise SignalError(f"trigger: there is no message {trigger}")
        # The yaw rate determines the path; where there is none the wheels do.
        order = [name for name in ("yaw_rate", "wheel_speed", *_FIELDS) if name in self._message_of]
        first = self._message_of[order[0]] if order else None
        maker = first if trigger is None else messages[trigger]
        self._trigger = None if maker is None else (maker.identifier, maker.extended)

    @property
    def quantities(self) -> tuple[CanQuantity, ...]:
        """What its frames should give; the gear is only in the speed's sign."""
        return tuple(name for name in QUANTITIES if name in self._message_of and name != "reverse_gear")

    def take(self, frame: CanFrame, time_ns: int) -> list[Message]:
        """A frame at its GPS time; what it completes, mostly nothing."""
        key = (frame.identifier, frame.extended)
        readings = self._readings.get(key, [])
        self.counts["frames.read"] += 1
        for reading in readings:
            self._values[reading.name] = (time_ns, self._value(reading, frame.data))
        messages: list[Message] = []
        if any(reading.name == "stroke_height" for reading in readings):
            messages += self._stroke(time_ns)
        if key == self._trigger:
            messages += self._motion(time_ns)
        return messages

    def _value(self, reading: _SignalReading, data: bytes) -> float | None:
        signal = reading.signal
        raw = signal.raw(data)
        if raw is None:
            self.counts["frames.short"] += 1
            return None
        physical = raw * signal.factor + signal.offset
        # Half a step more: 255 × 0.01 is more than 2.55.
        least, most = signal.least - abs(signal.factor) / 2.0, signal.most + abs(signal.factor) / 2.0
        out_of_range = signal.least < signal.most and not least <= physical <= most
        if raw in reading.invalid or out_of_range:
            self.counts[f"{reading.name}.invalid"] += 1
            return None
        return float(raw) if reading.name == "reverse_gear" else physical * reading.factor

    def _newest(self, name: CanQuantity, time_ns: int) -> float | None:
        at_ns, value = self._values.get(name, (None, None))
        # Not older, and not later: the clock may have been set back.
        if at_ns is None or not 0 <= time_ns - at_ns <= self._oldest_ns:
            if name in self._message_of:
                self.counts[f"{name}.missing"] += 1
            return None
        return value

    def _motion(self, time_ns: int) -> list[Message]:
        values = {field: self._newest(name, time_ns) for name, field in _FIELDS.items()}
        speed_m_s = values["wheel_speed_m_s"]
        if "reverse_gear" in self._message_of and speed_m_s is not None:
            gear = self._newest("reverse_gear", time_ns)
            sign = None if gear is None else self._signs.get(int(gear))
            # Out of gear the direction of the wheels is unknown, unless they are at rest.
            if sign is None:
                self.counts["wheel_speed.without_sign"] += 1
            values["wheel_speed_m_s"] = speed_m_s * sign if sign is not None else None if speed_m_s else 0.0
        for _ in _FIELDS:
            try:
                return [Motion(time_ns=time_ns, **values)]
            except ValidationError as error:
                name = str(error.errors(include_url=False)[0]["loc"][0])
                if values.get(name) is None:
                    self.counts["frames.time_out_of_range"] += 1
                    break
                self.counts[f"{name}.out_of_range"] += 1
                values[name] = None
        return []

    def _stroke(self, time_ns: int) -> list[Message]:
        height_m, sigma_m = self._newest("stroke_height", time_ns), self._settings.stroke_sigma_m
        if height_m is None:
            return []
        try:
            return [Suspension(time_ns=time_ns, stroke_height_m=height_m, stroke_sigma_m=sigma_m)]
        except ValidationError:
            self.counts["stroke_height.out_of_range"] += 1
            return []


def quantities_in(message: Message) -> list[CanQuantity]:
    """The quantities that are known in what came of frames."""
    if not isinstance(message, Motion):
        return ["stroke_height"]
    return [name for name, field in _FIELDS.items() if getattr(message, field) is not None]


def _reading(
    messages: Mapping[str, DbcMessage], name: CanQuantity, use: SignalSettings
) -> tuple[DbcMessage, _SignalReading]:
    message_name, _, signal_name = (use.signal or "").partition(".")
    message = messages.get(message_name)
    signal = message.signals.get(signal_name) if message is not None else None
    if message is None or signal is None:
        what = f"message {message_name}" if message is None else f"signal {signal_name} in {message_name}"
        raise SignalError(f"{name}: there is no {what}; expected MESSAGE.SIGNAL of the DBC file")
    if signal.multiplexed:
        raise SignalError(f"{name}: {use.signal} is multiplexed, expected a signal that is in every frame")
    if signal.real:
        text = f"{name}: {use.signal} is a floating-point signal, expected an integer with a factor"
        raise SignalError(text)
    _check_codes(f"{name}: invalid", signal, use.invalid)
    wanted, _ = QUANTITIES[name]
    unit: Unit | None = "1" if wanted == "code" else use.unit
    if unit is None or UNITS[unit][0] != wanted:
        raise SignalError(f"{name}: unit is {unit or 'not set'}, expected one of a {wanted}")
    if wanted != "code" and spelt(signal.unit) not in (None, unit):
        raise SignalError(f"{name}: the DBC file has {use.signal} in {signal.unit}, the settings say {unit}")
    factor = UNITS[unit][1] * use.scale
    return message, _SignalReading(name=name, signal=signal, factor=factor, invalid=frozenset(use.invalid))


def _check_codes(field: str, signal: DbcSignal, codes: Iterable[int]) -> None:
    """One that the signal can never be would be passed over in silence."""
    for code in codes:
        if code not in signal.holds:
            kind = "signed" if signal.signed else "unsigned"
            raise SignalError(
                f"{field}: {code}, expected {signal.holds[0]} to {signal.holds[-1]}: the DBC file has"
                f" {signal.message}.{signal.name} {kind}, of {signal.bits} bits"
            )
