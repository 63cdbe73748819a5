"""Motion out of frames: what is missing, old, invalid or beyond its range is None, and the rest in SI units."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from camber.formats.lidar_can.candump import CandumpDecoder, CanFrame, candump_text
from camber.formats.lidar_can.dbc import read_dbc
from camber.schemas.motion import Motion, Suspension
from camber.sensors.can_motion import CanMotion, CanSettings, SignalError, SignalSettings
from camber.sensors.inputs import gps_ns
from camber.simulator.output.can_frames import DBC, INVALID, STEERING_RATIO, can_frames
from camber.simulator.vehicle.sensor_clock import Readings
from camber.simulator.vehicle.sensors import VehicleReadings, motion_messages

MESSAGES = read_dbc(DBC, "can.dbc")


def use(signal: str, unit: Any, *invalid: int, scale: float = 1.0) -> SignalSettings:
    return SignalSettings(signal=signal, unit=unit, invalid=invalid, scale=scale)


SETTINGS = CanSettings(
    wheel_speed=use("Wheels.Speed", "km/h", INVALID),
    yaw_rate=use("Dynamics.YawRate", "deg/s", INVALID),
    steering_angle=use("Steering.WheelAngle", "deg", INVALID, scale=1.0 / STEERING_RATIO),
    pitch=use("Attitude_Pitch.NoseUp", "deg", INVALID, scale=-1.0),
    roll=use("Attitude_Roll.LeftUp", "deg", INVALID),
    stroke_height=use("Suspension.Height", "mm", INVALID),
)
GEAR = 'BO_ 5 Gear: 1 G\n SG_ Now : 0|4@1+ (1,0) [0|15] "" G\n'
START_NS = 1_400_000_000 * 1_000_000_000
STEP_NS = 20_000_000


def frame(name: str, raw: int | None = None, length: int | None = None) -> CanFrame:
    message = MESSAGES[name]
    (signal,) = message.signals.values()
    data = signal.placed(INVALID if raw is None else raw, bytes(message.length_bytes))
    return can_frame(message.identifier, data[:length], extended=message.extended)


def can_frame(identifier: int, data: bytes, *, extended: bool = False) -> CanFrame:
    return CanFrame(time_ns=0, bus="can0", identifier=identifier, extended=extended, data=data)


def motion_of(*frames: tuple[float, CanFrame], **more: object) -> list:
    can = CanMotion(MESSAGES, SETTINGS.model_copy(update=more))
    return [message for at_s, each in frames for message in can.take(each, START_NS + round(at_s * 1e9))]


def readings(seed: int = 2) -> VehicleReadings:
    """Units that send at different times, and now and then a gap."""
    rng = np.random.default_rng(seed)

    def one(sigma: float, rate_hz: float) -> Readings:
        n = round(10 * rate_hz)
        time_ns = START_NS + np.sort(rng.integers(0, 10_000_000_000, n))
        value = rng.normal(0.0, sigma, n)
        value[rng.random(n) < 0.05] = math.nan
        return Readings(time_ns=time_ns, true_time_ns=time_ns, value=value)

    sizes = {"wheel_speed": 8.0, "yaw_rate": 0.2, "steering": 0.1, "pitch": 0.03, "roll": 0.03}
    sizes |= {"stroke": 0.1, "ranging": 1.0}
    return VehicleReadings(
        **{name: one(size, 50 if size in (8.0, 0.2) else 20) for name, size in sizes.items()}
    )


def test_what_a_simulated_vehicle_sends_on_its_bus_is_its_motion() -> None:
    """Against the simulator's gateway on the same readings, within what the signals resolve."""
    sent = readings()
    decoder = CandumpDecoder("can.log")
    frames = decoder.feed(candump_text(can_frames(sent)).encode()) + decoder.finish()
    can = CanMotion(MESSAGES, SETTINGS)
    made = [message for each in frames for message in can.take(each, gps_ns(each.time_ns))]
    motion = [message for message in made if isinstance(message, Motion)]
    # What a sensor marks as invalid is not known, where the simulator's table has NaN.
    table = [
        {name: None if value is None or math.isnan(value) else value for name, value in row.items()}
        for row in _rows(sent)
    ]
    assert len(motion) == len(table) == 500
    steps = {
        "wheel_speed_m_s": 0.01 / 3.6,
        "yaw_rate_rad_s": math.radians(0.005),
        "steering_angle_rad": math.radians(0.05) / STEERING_RATIO,
        "pitch_rad": math.radians(0.001),
        "roll_rad": math.radians(0.001),
    }
    for one, true in zip(motion, table, strict=True):
        assert 0 <= true["time_ns"] - one.time_ns < 1000
        for name, step in steps.items():
            value = getattr(one, name)
            assert (value is None) == (true[name] is None), (name, one, true)
            assert value is None or value == pytest.approx(true[name], abs=0.501 * step)
    strokes = [message for message in made if isinstance(message, Suspension)]
    assert sent.stroke is not None
    known = sent.stroke.value[~np.isnan(sent.stroke.value)]
    np.testing.assert_allclose([stroke.stroke_height_m for stroke in strokes], known, atol=5.1e-5)


def _rows(sent: VehicleReadings) -> list[dict]:
    """The simulator's gateway, whose message cannot carry NaN: with a number in its place, and back."""
    mark = 6.5
    columns = {name: getattr(sent, name) for name in VehicleReadings.__slots__}
    marked = VehicleReadings(
        **{name: replace(one, value=np.nan_to_num(one.value, nan=mark)) for name, one in columns.items()}
    )
    return [
        {name: math.nan if value == mark else value for name, value in message.model_dump().items()}
        for message in motion_messages(marked)
    ]


def test_units_and_signs_are_those_of_the_settings() -> None:
    (made,) = motion_of(
        (0.0, frame("Wheels", -3600)),
        (0.0, frame("Steering", 300)),
        (0.0, frame("Attitude_Pitch", 2000)),
        (0.0, frame("Dynamics", 2000)),
    )
    assert made.wheel_speed_m_s == pytest.approx(-10.0)
    assert made.steering_angle_rad == pytest.approx(math.radians(1.0))
    assert made.pitch_rad == pytest.approx(math.radians(-2.0))
    assert made.yaw_rate_rad_s == pytest.approx(math.radians(10.0))
    assert made.roll_rad is None


def test_what_is_old_invalid_cut_off_or_beyond_its_range_is_not_known() -> None:
    cases = {
        "old": (-0.11, frame("Wheels", 100)),
        "ahead": (0.01, frame("Wheels", 100)),
        "invalid": (0.0, frame("Wheels")),
        "short": (0.0, frame("Wheels", 100, 1)),
        "range": (0.0, frame("Wheels", 30_001)),
    }
    for why, (at_s, each) in cases.items():
        (made,) = motion_of((at_s, each), (0.0, frame("Dynamics", 1)))
        assert made.wheel_speed_m_s is None, why
        assert made.yaw_rate_rad_s is not None
    (made,) = motion_of((-0.09, frame("Wheels", 100)), (0.0, frame("Dynamics", 1)))
    assert made.wheel_speed_m_s is not None


@pytest.mark.parametrize(("factor", "most"), [(0.01, 2.55), (0.1, 0.3), (0.05625, 5.625), (-0.01, 0.0)])
def test_the_ends_of_a_range_are_in_it_and_one_step_beyond_is_not(factor: float, most: float) -> None:
    least = round(255 * factor, 2) if factor < 0.0 else 0.0
    line = f'BO_ 1 A: 2 X\n SG_ Speed : 0|16@1- ({factor},0) [{least}|{most}] "m/s" X\n'
    can = CanMotion(read_dbc(line, "x.dbc"), CanSettings(wheel_speed=use("A.Speed", "m/s")))
    last = round((most if factor > 0.0 else least) / factor)

    def speed(raw: int) -> float | None:
        (made,) = can.take(can_frame(1, raw.to_bytes(2, "little", signed=True)), START_NS)
        return made.wheel_speed_m_s

    assert speed(0) == 0.0
    assert speed(last) == pytest.approx(last * factor)
    assert speed(last + 1) is None
    assert speed(-1) is None


def test_a_value_that_becomes_invalid_is_not_known_and_makes_a_motion_all_the_same() -> None:
    *_, last = motion_of((0.0, frame("Wheels", 100)), (0.01, frame("Wheels")), (0.02, frame("Dynamics", 1)))
    assert last.wheel_speed_m_s is None
    (made,) = motion_of((0.0, frame("Wheels", 360)), (0.0, frame("Dynamics")))
    assert (made.yaw_rate_rad_s, made.wheel_speed_m_s) == (None, pytest.approx(1.0))


def test_another_message_can_make_the_motion() -> None:
    frames = (0.0, frame("Dynamics", 1)), (0.01, frame("Wheels", 1)), (0.02, frame("Wheels", 2))
    made = motion_of(*frames, trigger="Wheels")
    assert [round((each.time_ns - START_NS) / 1e6) for each in made] == [10, 20]


def test_frames_of_others_and_of_another_length_of_identifier_change_nothing() -> None:
    other = frame("Dynamics", 1)
    assert motion_of((0.0, can_frame(other.identifier, other.data, extended=True))) == []
    assert motion_of((0.0, can_frame(0x7FF, bytes(8)))) == []


@pytest.mark.parametrize(("gear", "speed_m_s"), [(7, -10.0), (1, 10.0), (0, None), (15, None), (None, None)])
def test_where_the_speed_has_no_sign_the_gear_gives_it(gear: int | None, speed_m_s: float | None) -> None:
    messages = read_dbc(DBC.replace("CM_", f"{GEAR}\nCM_"), "can.dbc")
    of_gear = {"reverse_gear": use("Gear.Now", None), "reverse_codes": (7,), "forward_codes": (1, 2, 3)}
    can = CanMotion(messages, SETTINGS.model_copy(update=of_gear))
    if gear is not None:
        can.take(can_frame(5, bytes([gear])), START_NS)
    can.take(frame("Wheels", 3600), START_NS)
    (made,) = can.take(frame("Dynamics", 1), START_NS)
    assert made.wheel_speed_m_s == (None if speed_m_s is None else pytest.approx(speed_m_s))
    can.take(frame("Wheels", 0), START_NS)
    (made,) = can.take(frame("Dynamics", 1), START_NS)
    assert made.wheel_speed_m_s == 0.0


@pytest.mark.parametrize(
    ("dbc", "fields", "error"),
    [
        (DBC, {"yaw_rate": use("Dynamics.Yaw", "deg/s")}, "yaw_rate: there is no signal Yaw in Dynamics;"),
        (DBC, {"yaw_rate": use("YawRate", "deg/s")}, "yaw_rate: there is no message YawRate;"),
        (DBC, {"yaw_rate": use("Dynamics.YawRate", "rad/s")}, "yaw_rate: the DBC file has Dynamics.YawRate in deg/s"),
        (DBC, {"yaw_rate": use("Dynamics.YawRate", "deg")}, "yaw_rate: unit is deg, expected one of a turn rate"),
        (DBC, {"yaw_rate": use("Dynamics.YawRate", None)}, "yaw_rate: unit is not set, expected one of a turn rate"),
        (DBC, {"yaw_rate": use("Dynamics.YawRate", "deg/s", -1, 65_535)}, "yaw_rate: invalid: 65535, expected -32768"
         " to 32767: the DBC file has Dynamics.YawRate signed, of 16 bits$"),
        (GEAR, {"reverse_gear": use("Gear.Now", None), "reverse_codes": (7, -1)}, "reverse_codes: -1, expected 0 to"
         " 15: the DBC file has Gear.Now unsigned, of 4 bits$"),
        (DBC.replace("SG_ YawRate", "SG_ YawRate m2"), {"yaw_rate": SETTINGS.yaw_rate},
         "yaw_rate: Dynamics.YawRate is multiplexed"),
        (DBC.replace("CM_", "SIG_VALTYPE_ 434 YawRate : 1;\nCM_"), {"yaw_rate": SETTINGS.yaw_rate},
         "yaw_rate: Dynamics.YawRate is a floating-point signal"),
    ],
)  # fmt: skip
def test_a_signal_that_cannot_be_is_one_clear_line(dbc: str, fields: dict[str, Any], error: str) -> None:
    with pytest.raises(SignalError, match=f"^{error}") as refused:
        CanMotion(read_dbc(dbc, "can.dbc"), CanSettings(**fields))
    assert "\n" not in str(refused.value)
