from pathlib import Path

import pytest

from camber.runtime.settings import ConfigError, load
from camber.sensors.settings import SensorsSettings
from camber.simulator.output.can_frames import DBC
from camber.simulator.output.lidar_packets import ouster_metadata


def read(folder: Path, text: str) -> SensorsSettings:
    (folder / "can.dbc").write_text(DBC)
    (folder / "m.json").write_text(ouster_metadata())
    free_running = ouster_metadata().replace("TIME_FROM_PTP_1588", "TIME_FROM_INTERNAL_OSC")
    (folder / "free.json").write_text(free_running)
    other_imu = '"udp_profile_imu": "ACCEL32_GYRO32_NMEA", "udp_profile_lidar"'
    (folder / "imu.json").write_text(ouster_metadata().replace('"udp_profile_lidar"', other_imu))
    path = folder / "sensors.toml"
    path.write_text(text.replace("DIR", str(folder)))
    return load(SensorsSettings, ["--config", str(path)], prog="camber sensors")[0]


LIDAR = '[lidar]\nsource = "udp:2368"\n'
OUSTER = LIDAR + 'model = "ouster"\n'
CAN = '[can]\nsource = "socketcan:can0"\n'
CODE = 'wheel_speed = { signal = "Wheels.Speed", unit = "km/h", invalid = [65535] }\n'
GEAR = 'dbc = "DIR/can.dbc"\nreverse_gear = { signal = "Wheels.Speed" }\n'
SPEED = 'wheel_speed = { signal = "Wheels.Speed", unit = "km/h" }\n'


@pytest.mark.parametrize(
    "text",
    [
        "",
        LIDAR + 'model = "VLP-16"\nstamps = "utc_hour"\n',
        OUSTER + 'stamps = "tai"\nmetadata = "DIR/m.json"\n',
        OUSTER + 'stamps = "tai"\nmetadata = "DIR/m.json"\nimu_port = 7503\n',
        OUSTER + 'stamps = "tai"\nmetadata = "DIR/imu.json"\n',
        OUSTER + 'stamps = "arrival"\nmetadata = "DIR/free.json"\n',
        CAN + 'dbc = "DIR/can.dbc"\n' + SPEED,
        '[lidar]\nsource = "udp:239.1.1.1:7502"\nmodel = "HDL-32E"\nstamps = "arrival"\n',
    ],
)
def test_what_is_whole_is_taken(tmp_path: Path, text: str) -> None:
    read(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (LIDAR + 'stamps = "utc_hour"\n', "lidar: model: missing"),
        (LIDAR + 'model = "VLP-16"\n', "lidar: stamps: missing; what the sensor's clock counts cannot be guessed"),
        (LIDAR + 'model = "VLP-16"\nstamps = "tai"\n', "lidar: stamps: tai, expected utc_hour or arrival"),
        (LIDAR + 'model = "VLS-128"\n', "lidar.model: Input should be 'VLP-16', 'Puck Hi-Res'"),
        (OUSTER + 'stamps = "tai"\n', "lidar: metadata: missing; an Ouster cannot be read without"),
        (OUSTER + 'stamps = "tai"\nmetadata = "DIR/x"\n', "lidar: DIR/x: No such file"),
        (OUSTER + 'stamps = "tai"\nmetadata = "DIR/free.json"\n', "lidar: stamps: tai, expected arrival: DIR/free"),
        (OUSTER + 'stamps = "utc_hour"\nmetadata = "DIR/m.json"\n', "lidar: stamps: utc_hour, expected utc, tai, gps"),
        (LIDAR + 'model = "VLP-16"\nstamps = "utc_hour"\nimu_port = 7503\n',
         "lidar: imu_port: an Ouster has IMU packets, expected none"),
        (OUSTER + 'stamps = "tai"\nmetadata = "DIR/m.json"\nimu_port = 2368\n',
         "lidar: imu_port: 2368, expected another port than that of the lidar packets"),
        (OUSTER + 'stamps = "tai"\nmetadata = "DIR/imu.json"\nimu_port = 7503\n',
         "lidar: imu_port: DIR/imu.json has IMU packets of ACCEL32_GYRO32_NMEA, expected LEGACY"),
        (OUSTER + 'imu_port = 0\n', "lidar.imu_port: Input should be greater than or equal to 1"),
        ('[lidar]\nsource = "tcp:1"\n', "lidar.source: 'tcp:1': expected udp:PORT, udp:ADDRESS:PORT or pcap:FILE"),
        ('[lidar]\nsource = "pcap:DIR/no.pcap"\n', "lidar.source: DIR/no.pcap: no such file"),
        (CAN + SPEED, "can: dbc: missing"),
        (CAN + 'dbc = "DIR/can.dbc"\n', "can: wheel_speed, yaw_rate …: missing; expected at least one signal"),
        (CAN + 'dbc = "DIR/m.json"\n' + SPEED, "can: m.json: content, expected messages, BO_ … of a DBC file"),
        (CAN + 'dbc = "DIR/can.dbc"\n' + SPEED.replace("km/h", "m/s"), "can: wheel_speed: the DBC file has Wheels"),
        (CAN + 'dbc = "DIR/can.dbc"\n' + CODE, "sensors.toml: can: wheel_speed: invalid: 65535, expected -32768 to 32"),
        (CAN + GEAR + SPEED, "can: reverse_codes: missing; which values of reverse_gear mean backwards?"),
        (CAN + GEAR + SPEED + "reverse_codes = [7]\n", "can: forward_codes: missing; which values of rev"),
        (CAN + GEAR + SPEED + "reverse_codes = [7]\nforward_codes = [1, 7]\n", "can: forward_codes: 7 is in reverse"),
        ('clock = "replay"\n', "clock: replay, expected system"),
    ],
)  # fmt: skip
def test_what_is_missing_or_does_not_fit_is_one_clear_line(tmp_path: Path, text: str, error: str) -> None:
    with pytest.raises(ConfigError) as refused:
        read(tmp_path, text)
    line = str(refused.value)
    assert error.replace("DIR", str(tmp_path)) in line
    assert "\n" not in line
