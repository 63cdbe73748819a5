"""Packets of Velodyne and Ouster sensors: decoded by the manuals' formulas; invalid ones are refused with a reason."""

import json

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.lidar_can import ouster, velodyne
from camber.formats.lidar_can.firings import Firings
from camber.formats.lidar_can.ouster_metadata import PROFILES, read_ouster_metadata
from camber.formats.lidar_can.velodyne import MODELS, VelodyneDecoder

MATRIX = np.eye(4).reshape(-1).tolist()


def velodyne_packet(
    name: str = "HDL-32E", *, azimuth: int = 1000, stamp_us: int = 7, mode: int = 0x37
) -> bytes:
    model = MODELS[name]
    packet = np.zeros((), velodyne.PACKET)
    packet["blocks"]["flag"] = velodyne.BLOCK_FLAG
    packet["blocks"]["azimuth"] = (azimuth + 20 * np.arange(12)) % 36_000
    if mode == velodyne.DUAL:
        packet["blocks"]["azimuth"] = (azimuth + 20 * (np.arange(12) // 2)) % 36_000
    packet["blocks"]["beams"]["distance"] = 1000 + np.arange(12 * 32).reshape(12, 32)
    packet["blocks"]["beams"]["brightness"] = 9
    packet["stamp_us"], packet["mode"], packet["model"] = stamp_us, mode, model.code
    return packet.tobytes()


@pytest.mark.parametrize("name", MODELS)
def test_directions_distances_and_times_of_a_velodyne(name: str) -> None:
    """Reference: the manual's formulas, one point at a time."""
    model, decoder = MODELS[name], VelodyneDecoder(MODELS[name])
    decoded = decoder.decode([velodyne_packet(name)])
    firings = decoded.firings
    assert firings is not None
    assert decoded.stamp_ns == [7000]
    beams = len(model.elevation_deg)
    per_block = 32 // beams
    for firing in range(12 * per_block):
        block, part = divmod(firing, per_block)
        assert firings.after_ns[firing] == round(firing * model.firing_ns)
        for beam in range(beams):
            share = (part + model.beam_after_ns[beam] / model.firing_ns) / per_block
            offset_deg = model.azimuth_deg[beam] if model.azimuth_deg else 0.0
            around = np.radians((1000 + 20 * block + 20 * share) / 100.0 + offset_deg)
            up = np.radians(model.elevation_deg[beam])
            distance = (1000 + 32 * block + beams * part + beam) * model.step_m
            x_right, y_ahead = (distance * np.cos(up) * f(around) for f in (np.sin, np.cos))
            rise = distance * np.sin(up) + (model.up_mm[beam] / 1000.0 if model.up_mm else 0.0)
            np.testing.assert_allclose(firings.points_m[firing, beam], (y_ahead, -x_right, rise), atol=2e-5)


def test_of_two_returns_the_last_is_taken() -> None:
    decoder = VelodyneDecoder(MODELS["VLP-16"])
    firings = decoder.decode([velodyne_packet("VLP-16", mode=velodyne.DUAL)]).firings
    assert firings is not None
    assert len(firings) == 12
    blocks = np.linalg.norm(firings.points_m[::2, 0].astype(float), axis=1) / 0.002
    np.testing.assert_allclose(blocks, 1000 + 32 * np.arange(0, 12, 2), atol=3.0)


def test_the_turn_begins_at_the_seam() -> None:
    for seam_deg, azimuth, turn in ((180.0, 18_000, 0.0), (180.0, 17_900, 0.9972), (0.0, 9_000, 0.25)):
        decoder = VelodyneDecoder(MODELS["HDL-32E"], seam_deg)
        firings = decoder.decode([velodyne_packet(azimuth=azimuth)]).firings
        assert firings is not None
        assert firings.turn[0] == pytest.approx(turn, abs=1e-4)


def test_an_invalid_velodyne_packet_is_refused_with_its_reason() -> None:
    good = velodyne_packet()
    wrong = {
        "size": good[:-1],
        "flag": b"\xff\xdd" + good[2:],
        "model": velodyne_packet("VLP-16"),
        "mode": good[:1204] + b"\x00" + good[1205:],
        "stamp": velodyne_packet(stamp_us=3_600_000_000),
        "azimuth": velodyne_packet()[:2] + b"\xff\xff" + good[4:],
    }
    decoder = VelodyneDecoder(MODELS["HDL-32E"])
    for reason, packet in wrong.items():
        decoded = decoder.decode([packet, good])
        assert decoded.refused == {reason: 1}
        assert decoded.stamp_ns == [None, 7000]
        assert decoded.firings is not None
        assert set(decoded.firings.packet.tolist()) == {1}
    details = decoder.decode(list(wrong.values())).details
    assert details.keys() == wrong.keys()
    assert details["model"] == "a packet of VLP-16 (0x22), expected HDL-32E"
    assert details["flag"] == "a block that begins with FF DD, expected FF EE"


@pytest.mark.parametrize(
    ("code", "name"), [(0xA1, "VLS-128"), (0x63, "VLS-128"), (0x77, "a model that is not known")]
)
def test_a_packet_of_a_model_with_other_flags_is_named_as_that_model(code: int, name: str) -> None:
    packet = bytearray(velodyne_packet())
    for block, flag in enumerate((0xEE, 0xDD, 0xCC, 0xBB) * 3):
        packet[100 * block + 1] = flag
    packet[1205] = code
    expected = {"model": f"a packet of {name} (0x{code:02X}), expected HDL-32E"}
    assert VelodyneDecoder(MODELS["HDL-32E"]).decode([bytes(packet)]).details == expected


def metadata(profile: str = PROFILES[1], **changes: object) -> str:
    rng = np.random.default_rng(5)
    content: dict = {
        "sensor_info": {"prod_line": "OS-1-32", "prod_sn": "991"},
        "config_params": {"lidar_mode": "512x10", "timestamp_mode": "TIME_FROM_PTP_1588"},
        "lidar_data_format": {"columns_per_frame": 512, "columns_per_packet": 16, "udp_profile_lidar": profile},
        "beam_intrinsics": {
            "beam_altitude_angles": np.linspace(20, -20, 32).tolist(),
            "beam_azimuth_angles": rng.uniform(-4, 4, 32).tolist(),
            "beam_to_lidar_transform": [*MATRIX[:3], 15.8, *MATRIX[4:]],
        },
        "lidar_intrinsics": {"lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1]},
    }  # fmt: skip
    for path, value in changes.items():
        table, _, name = path.partition("__")
        if value is None:
            del content[table][name]
        else:
            content[table][name] = value
    return json.dumps(content)


def ouster_packet(profile: str, first: int = 0, stamp_ns: int = 5_000_000_000) -> np.ndarray:
    packet = np.zeros((), ouster.packet_type(profile, 32))
    if profile != "LEGACY":
        packet["type"], packet["serial"], packet["session"] = 1, list((991).to_bytes(5, "little")), [3, 0, 0]
    columns = packet["columns"]
    columns["place"] = first + np.arange(16)
    columns["stamp_ns"] = stamp_ns + 195_312 * np.arange(16)
    columns["status"] = 0xFFFF_FFFF if profile == "LEGACY" else 1
    columns["pixels"]["range"] = 2000 + np.arange(16 * 32).reshape(16, 32)
    columns["pixels"]["reflectivity"] = 77
    return packet


@pytest.mark.parametrize("profile", PROFILES)
def test_directions_distances_and_times_of_an_ouster(profile: str) -> None:
    """Reference: the manual's formulas, one point at a time."""
    sensor = read_ouster_metadata(metadata(profile), "m.json")
    decoded = ouster.OusterDecoder(sensor).decode([ouster_packet(profile, 32).tobytes()])
    firings = decoded.firings
    assert firings is not None
    assert decoded.stamp_ns == [5_000_000_000]
    assert decoded.session == (None if profile == "LEGACY" else 3)
    assert firings.after_ns.tolist() == [195_312 * k for k in range(16)]
    step_m = 0.008 if profile == "RNG15_RFL8_NIR8" else 0.001
    for column in range(16):
        assert firings.turn[column] == (32 + column) / 512
        encoder = 2 * np.pi * (1 - (32 + column) / 512)
        for beam in range(32):
            length = (2000 + 32 * column + beam) * step_m - 0.0158
            around, up = encoder - sensor.azimuth_rad[beam], sensor.elevation_rad[beam]
            x = length * np.cos(around) * np.cos(up) + 0.0158 * np.cos(encoder)
            y = length * np.sin(around) * np.cos(up) + 0.0158 * np.sin(encoder)
            np.testing.assert_allclose(
                firings.points_m[column, beam], (-x, -y, length * np.sin(up) + 0.03618), atol=1e-5
            )
    assert (firings.intensity == 77).all()
    assert firings.returned.all()


def test_an_invalid_ouster_packet_is_refused_with_its_reason() -> None:
    profile = "RNG19_RFL8_SIG16_NIR16"
    decoder = ouster.OusterDecoder(read_ouster_metadata(metadata(), "m.json"))
    other, beyond, kind, empty = (ouster_packet(profile) for _ in range(4))
    other["serial"] = 1
    beyond["columns"]["place"][3] = 512
    kind["type"] = 2
    empty["columns"]["status"] = 0
    cut = ouster_packet(profile).tobytes()[:-1]
    wrong = {"model": other, "turn": beyond, "type": kind, "empty": empty}
    for reason, data in {
        "size": cut,
        **{reason: packet.tobytes() for reason, packet in wrong.items()},
    }.items():
        decoded = decoder.decode([data])
        assert decoded.refused == {reason: 1}
        assert decoded.firings is None
        assert decoded.details.keys() == {reason}


def firings_of(packet: np.ndarray) -> Firings:
    decoder = ouster.OusterDecoder(read_ouster_metadata(metadata(), "m.json"))
    firings = decoder.decode([packet.tobytes()]).firings
    assert firings is not None
    return firings


def test_invalid_columns_and_missing_returns_are_left_out() -> None:
    packet = ouster_packet("RNG19_RFL8_SIG16_NIR16")
    packet["columns"]["status"][2] = 0
    packet["columns"]["pixels"]["range"][0, 5] = 0
    firings = firings_of(packet)
    assert (firings.turn * 512).round().astype(int).tolist() == [0, 1, *range(3, 16)]
    assert np.argwhere(~firings.returned).tolist() == [[0, 5]]


@pytest.mark.parametrize("off_ns", [2**63, 2**62, -(2**62), 10**9, -(10**9)])
def test_a_column_stamped_far_from_the_others_of_its_packet_is_left_out(off_ns: int) -> None:
    packet = ouster_packet("RNG19_RFL8_SIG16_NIR16")
    packet["columns"]["stamp_ns"][5] = (int(packet["columns"]["stamp_ns"][0]) + off_ns) % 2**64
    firings = firings_of(packet)
    assert (firings.turn * 512).round().astype(int).tolist() == [*range(5), *range(6, 16)]


def test_the_flat_metadata_of_earlier_firmware_are_read() -> None:
    nested = json.loads(metadata("LEGACY"))
    flat = {name: value for table in nested.values() for name, value in table.items()}
    del flat["udp_profile_lidar"]
    old, new = (read_ouster_metadata(json.dumps(each), "m.json") for each in (flat, nested))
    assert (old.profile, old.columns, old.serial) == ("LEGACY", 512, 991)
    np.testing.assert_array_equal(old.azimuth_rad, new.azimuth_rad)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"config_params__lidar_mode": None}, "m.json: lidar_mode is 'missing', expected a text"),
        ({"config_params__lidar_mode": "1024x11"}, "m.json: lidar_mode is '1024x11', expected COLUMNSxHZ"),
        ({"lidar_data_format__udp_profile_lidar": "FIVE_WORD_PIXEL"}, "m.json: udp_profile_lidar is 'FIVE_WORD_PIXEL'"),
        ({"lidar_data_format__columns_per_frame": 1024}, "m.json: columns_per_frame is '1024', expected 512"),
        ({"lidar_data_format__columns_per_packet": 8}, "m.json: columns_per_packet is '8', expected 16"),
        ({"beam_intrinsics__beam_altitude_angles": [1, 2]}, "m.json: beam_altitude_angles, beam_azimuth_angles, expe"),
        ({"beam_intrinsics__beam_azimuth_angles": "x"}, "m.json: beam_azimuth_angles is 'x', expected a list of numb"),
        ({"lidar_intrinsics__lidar_to_sensor_transform": [1, 0]}, "m.json: lidar_to_sensor_transform is '2 numbers', "),
        ({"beam_intrinsics__beam_to_lidar_transform": [1]}, "m.json: beam_to_lidar_transform is '1 numbers', expect"),
        ({"lidar_data_format__header_type": "FUSA"}, "m.json: header_type is 'FUSA', expected STANDARD"),
        ({"beam_intrinsics__beam_to_lidar_transform": None}, "m.json: lidar_origin_to_beam_origin_mm is 'missing'"),
    ],
)  # fmt: skip
def test_invalid_metadata_are_one_clear_error(changes: dict, message: str) -> None:
    with pytest.raises(FormatError) as error:
        read_ouster_metadata(metadata(**changes), "m.json")
    assert str(error.value).startswith(message)
