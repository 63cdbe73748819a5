"""Signals of a CAN bus → motion and suspension strokes.

One message of the bus, as a rule that with the yaw rate, makes a Motion each time it comes; the other quantities are
the newest that were said by then. What is older than `oldest_ns`, marked as invalid, beyond the range that the DBC file
gives, or not there at all is None.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import ValidationError

from camber.formats.lidar_can.candump import CanFrame
from camber.formats.lidar_can.dbc import DbcMessage, DbcSignal
from camber.schemas.base import Message
from camber.schemas.motion import Motion, Suspension
from camber.sensors.units import Quantity, Unit, quantity_of, si_of, spelt

Gives = Literal["wheel_speed", "yaw_rate", "steering_angle", "pitch", "roll", "stroke_height", "reverse_gear"]
QUANTITIES: dict[Gives, Quantity] = {
    "wheel_speed": "speed",
    "yaw_rate": "turn rate",
    "steering_angle": "angle",
    "pitch": "angle",
    "roll": "angle",
    "stroke_height": "length",
    "reverse_gear": "code",
}
_FIELDS: dict[Gives, str] = {
    "wheel_speed": "wheel_speed_m_s",
    "yaw_rate": "yaw_rate_rad_s",
    "steering_angle": "steering_angle_rad",
    "pitch": "pitch_rad",
    "roll": "roll_rad",
}


class SignalError(ValueError):
    """A signal cannot be what the settings say; one clear line."""


@dataclass(frozen=True, slots=True)
class SignalUse:
    """What the settings say of one signal: `name` is MESSAGE.SIGNAL, `scale` is applied after the unit."""

    name: str
    unit: Unit | None
    invalid: tuple[int, ...] = ()
    scale: float = 1.0


@dataclass(frozen=True, slots=True)
class _Value:
    time_ns: int
    value: float | None


@dataclass(frozen=True, slots=True)
class _Reading:
    """A signal with its conversion."""

    gives: Gives
    signal: DbcSignal
    factor: float
    invalid: frozenset[int]


class CanMotion:
    """Motion out of frames. Raises SignalError where a signal is not in the DBC file, or is of another unit."""

    def __init__(
        self,
        messages: Mapping[str, DbcMessage],
        uses: Mapping[Gives, SignalUse],
        *,
        trigger: str | None = None,
        oldest_ns: int = 100_000_000,
        reverse: Sequence[int] = (),
        forward: Sequence[int] = (),
        stroke_sigma_m: float = 0.003,
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._oldest_ns, self._stroke_sigma_m = oldest_ns, stroke_sigma_m
        self._signs = dict.fromkeys(forward, 1.0) | dict.fromkeys(reverse, -1.0)
        self._readings: dict[tuple[int, bool], list[_Reading]] = {}
        self._values: dict[Gives, _Value] = {}
        self._uses = frozenset(uses)
        named: dict[Gives, DbcMessage] = {}
        for gives, use in uses.items():
            message, reading = _reading(messages, gives, use)
            self._readings.setdefault((message.identifier, message.extended), []).append(reading)
            named[gives] = message
            if gives == "reverse_gear":
                _check_codes("reverse_codes", reading.signal, reverse)
                _check_codes("forward_codes", reading.signal, forward)
        if trigger is not None and trigger not in messages:
            raise SignalError(f"trigger: there is no message {trigger}")
        # The yaw rate tells the path; where there is none the wheels do.
        first = next(
            (named[gives] for gives in ("yaw_rate", "wheel_speed", *_FIELDS) if gives in named), None
        )
        maker = messages[trigger] if trigger is not None else first
        self._trigger = None if maker is None else (maker.identifier, maker.extended)

    @property
    def quantities(self) -> tuple[Gives, ...]:
        """What its frames should give; the gear is only in the speed's sign."""
        return tuple(gives for gives in QUANTITIES if gives in self._uses and gives != "reverse_gear")

    def take(self, frame: CanFrame, time_ns: int) -> list[Message]:
        """A frame at its GPS time; what it completes, mostly nothing."""
        key = (frame.identifier, frame.extended)
        readings = self._readings.get(key, [])
        self.counts["frames.read"] += 1
        for reading in readings:
            self._values[reading.gives] = _Value(time_ns, self._value(reading, frame.data))
        found: list[Message] = []
        if any(reading.gives == "stroke_height" for reading in readings):
            found += self._stroke(time_ns)
        if key == self._trigger:
            found += self._motion(time_ns)
        return found

    def _value(self, reading: _Reading, data: bytes) -> float | None:
        raw = reading.signal.raw(data)
        name = f"{reading.gives}.invalid"
        if raw is None:
            self.counts["frames.short"] += 1
            return None
        if raw in reading.invalid:
            self.counts[name] += 1
            return None
        signal = reading.signal
        physical = raw * signal.factor + signal.offset
        # Half a step more: 255 × 0.01 is more than 2.55.
        least, most = signal.least - abs(signal.factor) / 2.0, signal.most + abs(signal.factor) / 2.0
        if signal.least < signal.most and not least <= physical <= most:
            self.counts[name] += 1
            return None
        return float(raw) if reading.gives == "reverse_gear" else physical * reading.factor

    def _newest(self, gives: Gives, time_ns: int) -> float | None:
        said = self._values.get(gives)
        # Not older, and not later either: the clock may have been set back.
        if said is None or not 0 <= time_ns - said.time_ns <= self._oldest_ns:
            if gives in self._uses:
                self.counts[f"{gives}.missing"] += 1
            return None
        return said.value

    def _motion(self, time_ns: int) -> list[Message]:
        values = {_FIELDS[gives]: self._newest(gives, time_ns) for gives in _FIELDS}
        speed_m_s = values["wheel_speed_m_s"]
        if "reverse_gear" in self._uses and speed_m_s is not None:
            gear = self._newest("reverse_gear", time_ns)
            sign = None if gear is None else self._signs.get(int(gear))
            # Out of gear nobody knows which way the wheels turn, but where they stand.
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
        height_m = self._newest("stroke_height", time_ns)
        if height_m is None:
            return []
        try:
            return [
                Suspension(time_ns=time_ns, stroke_height_m=height_m, stroke_sigma_m=self._stroke_sigma_m)
            ]
        except ValidationError:
            self.counts["stroke_height.out_of_range"] += 1
            return []


def said_in(message: Message) -> list[Gives]:
    """The quantities that are known in what came of frames."""
    if not isinstance(message, Motion):
        return ["stroke_height"]
    return [gives for gives, field in _FIELDS.items() if getattr(message, field) is not None]


def _reading(messages: Mapping[str, DbcMessage], gives: Gives, use: SignalUse) -> tuple[DbcMessage, _Reading]:
    message_name, _, signal_name = use.name.partition(".")
    message = messages.get(message_name)
    signal = message.signals.get(signal_name) if message is not None else None
    if message is None or signal is None:
        what = f"message {message_name}" if message is None else f"signal {signal_name} in {message_name}"
        raise SignalError(f"{gives}: there is no {what}; expected MESSAGE.SIGNAL of the DBC file")
    if signal.multiplexed:
        raise SignalError(f"{gives}: {use.name} is multiplexed, expected a signal that is in every frame")
    if signal.real:
        raise SignalError(
            f"{gives}: {use.name} is a floating-point signal, expected an integer with a factor"
        )
    _check_codes(f"{gives}: invalid", signal, use.invalid)
    wanted = QUANTITIES[gives]
    unit: Unit | None = "1" if wanted == "code" else use.unit
    if unit is None or quantity_of(unit) != wanted:
        raise SignalError(f"{gives}: unit is {unit or 'not set'}, expected one of a {wanted}")
    said = spelt(signal.unit)
    if said is not None and wanted != "code" and said != unit:
        raise SignalError(f"{gives}: the DBC file has {use.name} in {signal.unit}, the settings say {unit}")
    return message, _Reading(gives, signal, si_of(unit) * use.scale, frozenset(use.invalid))


def _check_codes(field: str, signal: DbcSignal, codes: Iterable[int]) -> None:
    """One that the signal can never be would be passed over in silence."""
    held = signal.holds
    for code in codes:
        if code not in held:
            kind = "signed" if signal.signed else "unsigned"
            raise SignalError(
                f"{field}: {code}, expected {held[0]} to {held[-1]}: the DBC file has"
                f" {signal.message}.{signal.name} {kind}, of {signal.bits} bits"
            )
