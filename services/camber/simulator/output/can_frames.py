"""What a simulated vehicle's sensors say, as frames of its CAN bus, and the DBC file that explains them.

Made up, but as such buses are: both byte orders, an identifier of 29 bits, the angle of the steering wheel instead of
the front wheels', pitch positive nose up, and a raw value that means: not known. Each unit sends at its own times.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from camber.formats.lidar_can.candump import CanFrame
from camber.formats.lidar_can.dbc import DbcMessage, read_dbc
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.simulator.vehicle.sensor_clock import Readings
from camber.simulator.vehicle.sensors import VehicleReadings

BUS = "can0"
STEERING_RATIO = 15.0
INVALID = -32_768
DBC = """\
VERSION ""

NS_ :

BS_:

BU_: Gateway

BO_ 418 Wheels: 8 Gateway
 SG_ Speed : 7|16@0- (0.01,0) [-300|300] "km/h" Vector__XXX

BO_ 2566844929 Attitude_Pitch: 4 Gateway
 SG_ NoseUp : 0|16@1- (0.001,0) [-30|30] "deg" Vector__XXX

BO_ 2566845185 Attitude_Roll: 4 Gateway
 SG_ LeftUp : 0|16@1- (0.001,0) [-30|30] "deg" Vector__XXX

BO_ 194 Steering: 8 Gateway
 SG_ WheelAngle : 16|16@1- (0.05,0) [-1000|1000] "deg" Vector__XXX

BO_ 752 Suspension: 2 Gateway
 SG_ Height : 7|16@0- (0.1,0) [-500|3000] "mm" Vector__XXX

BO_ 434 Dynamics: 8 Gateway
 SG_ YawRate : 15|16@0- (0.005,0) [-150|150] "deg/s" Vector__XXX

CM_ SG_ 434 YawRate "positive to the left";
"""


@dataclass(frozen=True, slots=True)
class _Spoken:
    """`scale`: from what the sensor measures to what the signal says."""

    message: str
    signal: str
    scale: float


_SPOKEN = {
    "wheel_speed": _Spoken("Wheels", "Speed", 3.6),
    "steering": _Spoken("Steering", "WheelAngle", math.degrees(STEERING_RATIO)),
    "pitch": _Spoken("Attitude_Pitch", "NoseUp", -math.degrees(1.0)),
    "roll": _Spoken("Attitude_Roll", "LeftUp", math.degrees(1.0)),
    "stroke": _Spoken("Suspension", "Height", 1000.0),
    # Last: of what comes at the same time it is to be the last, for it makes the motion.
    "yaw_rate": _Spoken("Dynamics", "YawRate", math.degrees(1.0)),
}
SETTINGS = f"""\
[can]
source = "candump:can.log"
dbc = "can.dbc"
wheel_speed = {{ signal = "Wheels.Speed", unit = "km/h", invalid = [{INVALID}] }}
yaw_rate = {{ signal = "Dynamics.YawRate", unit = "deg/s", invalid = [{INVALID}] }}
# Positive nose up.
pitch = {{ signal = "Attitude_Pitch.NoseUp", unit = "deg", scale = -1.0, invalid = [{INVALID}] }}
roll = {{ signal = "Attitude_Roll.LeftUp", unit = "deg", invalid = [{INVALID}] }}
stroke_height = {{ signal = "Suspension.Height", unit = "mm", invalid = [{INVALID}] }}

# At the steering wheel: {STEERING_RATIO:g} times the angle of the front wheels.
[can.steering_angle]
signal = "Steering.WheelAngle"
unit = "deg"
scale = {1.0 / STEERING_RATIO!r}
invalid = [{INVALID}]
"""
"""With which `camber sensors` reads them."""


def can_frames(readings: VehicleReadings) -> list[CanFrame]:
    """All sensors' frames in the order of their times."""
    messages = read_dbc(DBC, "can.dbc")
    frames: list[tuple[int, CanFrame]] = []
    for name, spoken in _SPOKEN.items():
        said: Readings | None = getattr(readings, name)
        if said is not None:
            frames += _frames(said, spoken, messages[spoken.message])
    frames.sort(key=lambda timed: timed[0])
    return [frame for _, frame in frames]


def _frames(said: Readings, spoken: _Spoken, message: DbcMessage) -> Sequence[tuple[int, CanFrame]]:
    signal = message.signals[spoken.signal]
    frames = []
    for time_ns, value in zip(said.time_ns.tolist(), said.value.tolist(), strict=True):
        raw = INVALID if math.isnan(value) else round(value * spoken.scale / signal.factor)
        data = signal.placed(max(min(raw, 32_767), INVALID), bytes(message.length_bytes))
        frame = CanFrame(
            time_ns=unix_ns_from_gps_ns(time_ns),
            bus=BUS,
            identifier=message.identifier,
            extended=message.extended,
            data=data,
        )
        frames.append((time_ns, frame))
    return frames
