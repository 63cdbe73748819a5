"""A simulated vehicle's sensor readings as frames of its CAN bus, and the DBC file that describes them.

Invented, but as such buses are: both byte orders, an identifier of 29 bits, the angle of the steering wheel instead of
the front wheels', pitch positive nose up, and a raw value that means: not known. Each unit sends at its sampling times.
"""

from __future__ import annotations

import math

from camber.formats.lidar_can.candump import CanFrame
from camber.formats.lidar_can.dbc import read_dbc
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.simulator.vehicle.sensor_clock import Readings
from camber.simulator.vehicle.sensors import VehicleReadings

BUS = "can0"
STEERING_RATIO = 15.0  # chosen: of a compact car
INVALID = -32_768  # chosen: the one value of 16 bits that has no positive counterpart
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


_SIGNALS = {
    "wheel_speed": ("Wheels", "Speed", 3.6),
    "steering": ("Steering", "WheelAngle", math.degrees(STEERING_RATIO)),
    "pitch": ("Attitude_Pitch", "NoseUp", -math.degrees(1.0)),
    "roll": ("Attitude_Roll", "LeftUp", math.degrees(1.0)),
    "stroke": ("Suspension", "Height", 1000.0),
    # Last: of what comes at the same time it is to be the last, for it makes the motion.
    "yaw_rate": ("Dynamics", "YawRate", math.degrees(1.0)),
}
"""By reading: message and signal, and the scale from the reading to the signal."""
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
    for name, (message_name, signal_name, scale) in _SIGNALS.items():
        one: Readings | None = getattr(readings, name)
        message = messages[message_name]
        signal = message.signals[signal_name]
        pairs = [] if one is None else zip(one.time_ns.tolist(), one.value.tolist(), strict=True)
        for time_ns, value in pairs:
            raw = INVALID if math.isnan(value) else round(value * scale / signal.factor)
            data = signal.placed(max(min(raw, 32_767), INVALID), bytes(message.length_bytes))
            frame = CanFrame(
                time_ns=unix_ns_from_gps_ns(time_ns),
                bus=BUS,
                identifier=message.identifier,
                extended=message.extended,
                data=data,
            )
            frames.append((time_ns, frame))
    return [frame for _, frame in sorted(frames, key=lambda timed: timed[0])]
