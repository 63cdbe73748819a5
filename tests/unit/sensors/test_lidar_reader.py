"""Sweeps out of packets: those of the simulated sensors give the simulated sweeps, whatever happens in between."""

import json
from collections import Counter
from functools import cache
from random import Random
from unittest.mock import Mock

import numpy as np
import pytest

from camber.formats.lidar_can.firings import LidarDecoder
from camber.formats.lidar_can.ouster import OusterDecoder, packet_type
from camber.formats.lidar_can.ouster_metadata import read_ouster_metadata
from camber.formats.lidar_can.velodyne import MODELS, VelodyneDecoder
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_utc
from camber.schemas.lidar import Sweep
from camber.sensors.lidar_reader import LidarReader
from camber.sensors.sensor_clock import SensorClock, TimeScale
from camber.simulator.output.lidar_packets import (
    PATTERNS,
    PROFILE,
    ouster_metadata,
    ouster_packets,
    velodyne_packets,
)
from camber.simulator.scene import Shapes
from camber.simulator.vehicle.lidar import SimulatedLidar
from camber.simulator.vehicle.pose_track import PoseTrack
from camber.simulator.world.ray_tracing import ShapeTracer

KINDS = ("velodyne", "ouster")
# So that an hour ends within.
START_NS = gps_ns_from_utc(CalendarTime(2026, 3, 20, 9, 59, 59, 750_000_000))
LATE_NS = 300_000
OUSTER_PACKET = packet_type(PROFILE, 64)
GROUND = np.array([[[-90.0, -90, 0], [90, -90, 0], [90, 90, 0]], [[-90, -90, 0], [90, 90, 0], [-90, 90, 0]]])


@cache
def sweeps(kind: str) -> tuple[Sweep, ...]:
    """Four turns between poles and a wall, at 10 m/s."""
    tracer = ShapeTracer(
        Shapes.of(
            boxes=[(40.0, 0.0, 0.0, 2.0, 60.0, 20.0, 0.0)],
            cylinders=[(12.0, 6.0, 0.0, 0.15, 8.0), (-9.0, -5.0, 0.0, 0.2, 8.0)],
            triangles=GROUND,
        )
    )
    time_ns = START_NS + 10_000_000 * np.arange(42, dtype=np.int64)
    place = np.stack((0.1 * np.arange(42.0), np.zeros(42), np.full(42, 2.0)), axis=1)
    track = PoseTrack(time_ns=time_ns, position_m=place, angles_rad=np.tile([0.0, 0.0, 0.3], (42, 1)))
    lidar = SimulatedLidar(pattern=PATTERNS[kind], track=track, tracer=tracer, seed=1)
    return tuple(scan.sweep for scan in lidar.scans())


@cache
def packets(kind: str) -> tuple[tuple[int, bytes], ...]:
    """Arrival and payload."""
    made = velodyne_packets(sweeps(kind)) if kind == "velodyne" else ouster_packets(sweeps(kind))
    return tuple((time_ns + LATE_NS, payload) for time_ns, payload in made)


def reader(
    kind: str, scale: TimeScale | None = None, metadata: str | None = None, *, least_share: float = 0.5
) -> LidarReader:
    decoder: LidarDecoder = VelodyneDecoder(MODELS["HDL-32E"])
    if kind == "ouster":
        decoder = OusterDecoder(read_ouster_metadata(metadata or ouster_metadata(), "m.json"))
    clock = SensorClock(scale or ("utc_hour" if kind == "velodyne" else "tai"), 0, 100_000_000)
    return LidarReader("top", decoder, clock, least_share)


def read(
    one: LidarReader, arrived, at_once: int = 16
) -> tuple[list[Sweep], list[tuple[str, str]], Counter[str]]:
    """Sweeps, issues and counts of packets with their times of arrival, and perhaps senders."""
    result: list[Sweep] = []
    issues: list[tuple[str, str]] = []
    for k in range(0, len(arrived), at_once):
        times_ns, payloads, *senders = zip(*arrived[k : k + at_once], strict=True)
        result += one.take(payloads, times_ns, *senders)
        issues += one.issues
    return result + one.finish(), issues, one.counts


def alike(kind: str, measured: Sweep, true: Sweep) -> None:
    """The same measurements but for what the format rounds: 0.01° and microseconds of a Velodyne."""
    assert len(measured.points_m) == len(true.points_m)
    far_m = np.linalg.norm(true.points_m, axis=1)
    apart_m = np.linalg.norm(measured.points_m - true.points_m, axis=1)
    rounded_rad = np.radians(0.0055) if kind == "velodyne" else 0.0
    assert (apart_m <= rounded_rad * far_m + 2e-5).all()
    times, true_times = (each.time_ns + each.offset_ns.astype(np.int64) for each in (measured, true))
    assert np.abs(times - true_times).max() <= (1000 if kind == "velodyne" else 0)
    np.testing.assert_array_equal(measured.intensity, true.intensity)
    assert measured.offset_ns.max() <= 0
    assert (np.diff(measured.offset_ns) >= 0).all()
    assert 0 <= true.time_ns - measured.time_ns < 100_000
    assert measured.sensor == "top"


def all_alike(kind: str, measured: list[Sweep], first: int = 0) -> None:
    for a, b in zip(measured, sweeps(kind)[first:], strict=True):
        alike(kind, a, b)


@pytest.mark.parametrize("at_once", [1, 16, 10_000])
@pytest.mark.parametrize("kind", KINDS)
def test_packets_of_simulated_sweeps_give_them_again(kind: str, at_once: int) -> None:
    result, issues, counts = read(reader(kind), packets(kind), at_once)
    assert issues == []
    assert len(result) == len(sweeps(kind)) == 4
    all_alike(kind, result)
    assert counts["sweeps.whole"] == 4
    assert counts["packets.lost"] == counts["packets.late"] == counts["packets.repeated"] == 0


@pytest.mark.parametrize("kind", KINDS)
def test_packets_that_come_in_another_order_or_twice_change_nothing(kind: str) -> None:
    random = Random(4)
    shuffled = sorted(packets(kind), key=lambda packet: packet[0] + random.randrange(2_800_000))
    doubled = [packet for k, packet in enumerate(shuffled) for _ in range(2 if k % 50 == 3 else 1)]
    assert shuffled != list(packets(kind))
    result, issues, counts = read(reader(kind), doubled)
    assert issues == []
    all_alike(kind, result)
    assert counts["packets.repeated"] + counts["packets.late"] == len(doubled) - len(shuffled)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_lost_is_counted_and_costs_its_points_alone(kind: str) -> None:
    kept = [packet for k, packet in enumerate(packets(kind)) if k % 10 != 4]
    result, _, counts = read(reader(kind), kept)
    assert len(result) == 4
    assert counts["packets.lost"] == len(packets(kind)) - len(kept)
    for a, b in zip(result, sweeps(kind), strict=True):
        assert 0.85 < len(a.points_m) / len(b.points_m) < 0.95
        everything = set(map(tuple, np.round(b.points_m.astype(float), 1).tolist()))
        near = sum(tuple(p) in everything for p in np.round(a.points_m.astype(float), 1).tolist())
        assert near > (0.9 if kind == "velodyne" else 0.999) * len(a.points_m)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.2, 0.45, 0.9])
def test_of_a_long_gap_all_are_counted(kind: str, share: float) -> None:
    """In the third turn and the fourth; before, it is unknown what the sensor measures."""
    quarter = len(packets(kind)) // 4
    first = quarter * 9 // 4
    lost = round(share * quarter)
    *_, counts = read(reader(kind), packets(kind)[:first] + packets(kind)[first + lost :])
    assert counts["packets.lost"] == pytest.approx(lost, abs=1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("middle", [0.0, 0.3, 0.9])
def test_what_is_measured_in_no_turn_is_not_lost(kind: str, middle: float) -> None:
    """A field of view of 270°, and a packet lost here and there in it."""
    quarter = len(packets(kind)) / 4
    turns = [(k / quarter - middle + 0.5) % 1.0 - 0.5 for k in range(len(packets(kind)))]
    seen = [packet for turn, packet in zip(turns, packets(kind), strict=True) if abs(turn) > 0.125]
    kept = [packet for k, packet in enumerate(seen) if k % 20 != 7]
    *_, counts = read(reader(kind, least_share=0.3), seen)
    assert counts["packets.lost"] <= 1
    *_, counts = read(reader(kind, least_share=0.3), kept)
    assert counts["packets.lost"] == pytest.approx(len(seen) - len(kept), abs=2)


def test_of_two_returns_each_packet_that_is_lost_is_one() -> None:
    made = dual_velodyne(packets("velodyne"))
    kept = [packet for k, packet in enumerate(made) if k % 10 != 4]
    assert len(made) > 700
    *_, counts = read(reader("velodyne"), kept)
    assert counts["packets.lost"] == pytest.approx(len(made) - len(kept), abs=1)


def dual_velodyne(single: tuple[tuple[int, bytes], ...]) -> list[tuple[int, bytes]]:
    """Each block twice, so that a packet makes two; the second half is stamped by half a packet later."""
    made = []
    for arrival_ns, payload in single:
        for half in range(2):
            blocks = [payload[100 * (6 * half + k // 2) :][:100] for k in range(12)]
            stamp_us = int.from_bytes(payload[1200:1204], "little") + half * 6 * 46
            data = b"".join(blocks) + stamp_us.to_bytes(4, "little") + b"\x39\x21"
            made.append((arrival_ns + half * 276_480, data))
    return made


@pytest.mark.parametrize("kind", KINDS)
def test_sweeps_of_which_too_little_came_are_left_out(kind: str) -> None:
    quarter = len(packets(kind)) // 4
    result, _, counts = read(reader(kind), packets(kind)[quarter * 3 // 4 : 2 * quarter + quarter // 3])
    assert [round((sweep.time_ns - START_NS) / 1e8) for sweep in result] == [2]
    assert counts["sweeps.partial"] == 2


@pytest.mark.parametrize("kind", KINDS)
def test_two_turns_are_never_one_sweep_when_all_between_is_lost(kind: str) -> None:
    """From the middle of one turn to the middle of the next: places in the turn go on as if nothing were."""
    quarter = len(packets(kind)) // 4
    lost = packets(kind)[: quarter // 2] + packets(kind)[quarter * 3 // 2 + 3 :]
    result, *_ = read(reader(kind, least_share=0.2), lost)
    spans = [int(sweep.offset_ns[-1]) - int(sweep.offset_ns[0]) for sweep in result]
    assert max(spans) < 101_000_000
    assert len(result) == 4


@pytest.mark.parametrize("kind", KINDS)
def test_a_clock_that_is_set_back_within_a_turn_gives_no_sweep_of_two_times(kind: str) -> None:
    """60 ms at once: within what is accepted, and named."""
    later = [(arrival_ns, shifted(kind, payload, -60_000)) for arrival_ns, payload in packets(kind)]
    half = len(later) * 11 // 16
    result, issues, counts = read(reader(kind), [*packets(kind)[:half], *later[half:]], 8)
    assert {code for code, _ in issues} == {"lidar_clock_jumped"}
    assert counts["clock.jumps"] == 1
    assert len(result) == 3
    for k in range(2):
        alike(kind, result[k], sweeps(kind)[k])
    assert all(int(sweep.offset_ns[-1]) - int(sweep.offset_ns[0]) < 101_000_000 for sweep in result)


def shifted(kind: str, payload: bytes, by_us: int) -> bytes:
    return shifted_velodyne(payload, by_us) if kind == "velodyne" else shifted_ouster(payload, by_us * 1000)


def shifted_velodyne(payload: bytes, by_us: int) -> bytes:
    stamp_us = (int.from_bytes(payload[1200:1204], "little") + by_us) % 3_600_000_000
    return payload[:1200] + stamp_us.to_bytes(4, "little") + payload[1204:]


def shifted_ouster(payload: bytes, by_ns: int, session: int = 7) -> bytes:
    packet = np.frombuffer(payload, OUSTER_PACKET).copy()
    packet["columns"]["stamp_ns"] += np.uint64(by_ns % 2**64)
    packet["session"] = list(session.to_bytes(3, "little"))
    return packet.tobytes()


@pytest.mark.parametrize("kind", KINDS)
def test_a_clock_that_is_wrong_gives_no_sweep_but_an_issue(kind: str) -> None:
    by_us = 900_000_000 if kind == "velodyne" else -37_000_000
    wrong = [(arrival_ns, shifted(kind, payload, by_us)) for arrival_ns, payload in packets(kind)]
    result, issues, counts = read(reader(kind), wrong)
    assert result == []
    assert {code for code, _ in issues} == {"lidar_clock"}
    assert counts["packets.refused_time"] == len(packets(kind))


def test_a_sensor_that_starts_again_begins_a_new_sweep() -> None:
    half = len(packets("ouster")) // 2 + 20
    before, after = packets("ouster")[:half], packets("ouster")[half:]
    again = [(arrival_ns, shifted_ouster(payload, 0, session=8)) for arrival_ns, payload in after]
    result, issues, _ = read(reader("ouster", least_share=0.3), [*before, *again], 4)
    assert ("lidar_started_again", "the sensor's session is 8 now") in issues
    assert [round((sweep.time_ns - START_NS) / 1e8) for sweep in result] == [1, 2, 3, 4]
    assert len(result[2].points_m) < len(sweeps("ouster")[2].points_m)


def test_packets_of_others_are_counted_and_change_nothing() -> None:
    random = Random(9)
    mixed = []
    for packet in packets("velodyne"):
        mixed.append(packet)
        if random.random() < 0.05:
            mixed.append((packet[0], random.choice((b"", random.randbytes(1206), packets("ouster")[0][1]))))
    result, issues, _ = read(reader("velodyne"), mixed)
    assert {code for code, _ in issues} == {"lidar_packets"}
    all_alike("velodyne", result)


@pytest.mark.parametrize("columns", [0, 16, 256, 768])
@pytest.mark.parametrize("kind", KINDS)
def test_of_two_sensors_of_one_model_those_of_one_sender_are_read_and_the_other_is_named(
    kind: str, columns: int
) -> None:
    """The other one is a moment ahead: by their times alone its points would stand for those of the first. Here and
    there the network swaps two packets; and the other one looks elsewhere at the same time.
    """
    other = [
        (at_ns - 12_000, turned(kind, shifted(kind, data, -12), columns)) for at_ns, data in packets(kind)
    ]
    senders = ((packets(kind), "10.0.0.2"), (other[8:], "10.0.0.3"))
    both = sorted((*packet, sender) for sent, sender in senders for packet in sent)
    mixed = [(arrival_ns - 300_000 * (k % 50 == 7), *more) for k, (arrival_ns, *more) in enumerate(both)]
    one = reader(kind)
    result, issues, _ = read(one, mixed)
    assert len(result) == 4
    all_alike(kind, result)
    text = "packets from 10.0.0.3 too, not only of 10.0.0.2: set sender"
    assert set(issues) == {("lidar_packets", text)}
    assert one.counts["packets.of_others"] == len(other) - 8


def turned(kind: str, payload: bytes, columns: int) -> bytes:
    """The same packet of a sensor that is so many columns further on."""
    if kind == "velodyne" or not columns:
        return payload
    packet = np.frombuffer(payload, OUSTER_PACKET).copy()
    packet["columns"]["place"] = (packet["columns"]["place"] + columns) % 1024
    return packet.tobytes()


def test_another_sender_that_comes_first_is_not_read_for_ever() -> None:
    arrived = [(packets("velodyne")[0][0], b"unknown", "10.0.0.9")]
    for turn in range(8):
        for arrival_ns, payload in packets("velodyne"):
            later_us = 400_000 * turn
            packet = shifted_velodyne(payload, later_us)
            arrived.append((arrival_ns + later_us * 1000, packet, "10.0.0.2"))
        arrived.append((arrived[-1][0], b"unknown", "10.0.0.9"))
    result, _, counts = read(reader("velodyne"), arrived)
    # All but those of the first two seconds.
    assert len(result) == pytest.approx(32 - 20, abs=1)
    assert counts["packets.of_others"] > 7


def test_a_sensor_that_comes_back_with_another_address_is_read_again() -> None:
    half = len(packets("velodyne")) // 2
    one = reader("velodyne")
    result = []
    for k, (arrival_ns, payload) in enumerate(packets("velodyne")):
        late_us = 3_000_000 * (k >= half)
        sender = "10.0.0.2" if k < half else "10.0.0.3"
        result += one.take([shifted_velodyne(payload, late_us)], [arrival_ns + late_us * 1000], [sender])
    assert len(result) + len(one.finish()) == 4
    assert one.counts["packets.of_others"] == 0


@pytest.mark.parametrize("kind", KINDS)
def test_a_free_running_sensor_is_late_by_no_more_than_its_network(kind: str) -> None:
    """A packet leaves once its last measurement is made; that is not the delay of its first."""
    result, *_ = read(reader(kind, "arrival"), packets(kind))
    for sweep, true in zip(result, sweeps(kind), strict=True):
        assert abs(sweep.time_ns - true.time_ns - LATE_NS) < 150_000


@pytest.mark.parametrize("mode", ["2048x10", "512x10", "1024x20", "512x20", "2048x5", "1024x5"])
def test_an_ouster_in_another_mode_than_in_its_metadata_gives_no_sweep(mode: str) -> None:
    """The packets are those of 1024x10."""
    columns = int(mode.split("x")[0])
    text = json.dumps(json.loads(ouster_metadata())).replace('"1024x10"', f'"{mode}"')
    text = text.replace('"columns_per_frame": 1024', f'"columns_per_frame": {columns}')
    text = text.replace('"column_window": [0, 1023]', f'"column_window": [0, {columns - 1}]')
    metadata = read_ouster_metadata(text, "m.json")
    assert (metadata.columns, metadata.turns_hz) == (columns, int(mode.split("x")[1]))
    result, issues, _ = read(reader("ouster", metadata=text), packets("ouster"))
    assert result == []
    assert "lidar_model" in {code for code, _ in issues}


def misplaced() -> list[tuple[int, bytes]]:
    """The packets of four turns, one of them, in the third, with a column that the metadata do not have."""
    made = list(packets("ouster"))
    at = len(made) * 5 // 8
    packet = np.frombuffer(made[at][1], OUSTER_PACKET).copy()
    packet["columns"]["place"][0, 3] = 5000
    made[at] = made[at][0], packet.tobytes()
    return made


@pytest.mark.parametrize("at_once", [1, 16, 10_000])
def test_one_packet_of_another_mode_costs_its_turn_alone_however_packets_are_read(at_once: int) -> None:
    result, issues, _ = read(reader("ouster"), misplaced(), at_once)
    assert [round((sweep.time_ns - START_NS) / 1e8) for sweep in result] == [1, 2, 4]
    assert {code for code, _ in issues} == {"lidar_model"}


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_an_ouster_with_a_narrow_window_is_read_again_after_such_a_packet(share: float) -> None:
    """It is seen from one turn to the next, however much of a turn lacks."""
    quarter = len(packets("ouster")) // 4
    middle = len(packets("ouster")) * 5 // 8
    numbered = enumerate(misplaced())
    seen = [packet for k, packet in numbered if k % quarter < share * quarter or k == middle]
    result, *_ = read(reader("ouster", least_share=0.2), seen)
    assert round((result[-1].time_ns - START_NS) / 1e8 + 0.5 - share / 2.0) == 4


@pytest.mark.parametrize("gap_deg", [60, 120])
def test_a_velodyne_that_looks_to_one_side_alone_dates_what_is_after_the_gap(gap_deg: int) -> None:
    """Packets are filled up with what comes after the part that is not measured."""
    made = list(velodyne_packets(sweeps("velodyne")))
    firings = []
    for time_ns, payload in made:
        first_us = int.from_bytes(payload[1200:1204], "little")
        for k in range(12):
            block = payload[100 * k : 100 * k + 100]
            azimuth_deg = int.from_bytes(block[2:4], "little") / 100.0
            if abs(azimuth_deg - 90.0) > gap_deg / 2.0:
                firings.append((time_ns - (11 - k) * 46_080, first_us + k * 46.08, block))
    arrived = []
    for k in range(0, len(firings) - 11, 12):
        part = firings[k : k + 12]
        stamp = (round(part[0][1]) % 3_600_000_000).to_bytes(4, "little")
        arrived.append((part[-1][0] + LATE_NS, b"".join(block for *_, block in part) + stamp + b"\x37\x21"))
    one = reader("velodyne", least_share=0.3)
    result, issues, _ = read(one, arrived)
    assert issues == []
    assert len(result) == 4
    for sweep, true in zip(result, sweeps("velodyne"), strict=True):
        seam_ns = true.time_ns + float(np.median(since_the_seam_ns(true, true.time_ns)))
        # How fast it turns is known to a hundredth, from one packet's azimuths.
        assert np.abs(since_the_seam_ns(sweep, seam_ns)).max() < 0.01 * gap_deg / 360.0 * 1e8


def since_the_seam_ns(sweep: Sweep, seam_ns: float) -> np.ndarray:
    """When each point was measured, less what a turn of 0.1 s takes to its azimuth; of whole turns nothing."""
    turn = np.arctan2(-sweep.points_m[:, 1], sweep.points_m[:, 0]) / (2.0 * np.pi) - 0.5
    since_ns: np.ndarray = (sweep.time_ns - seam_ns) + sweep.offset_ns - turn * 1e8
    return (since_ns + 5e7) % 1e8 - 5e7


def test_of_packets_that_are_refused_each_issue_has_a_text() -> None:
    arrival_ns, payload = packets("velodyne")[0]
    one = reader("velodyne")
    one.take([payload[:-1] + b"\x22", payload[:512], payload], [arrival_ns] * 3)
    assert one.issues == [
        ("lidar_model", "a packet of VLP-16 (0x22), expected HDL-32E"),
        ("lidar_packets", "a packet of 512 bytes, expected 1206"),
    ]


def test_a_sensor_that_stands_still_gives_no_sweep_and_fills_no_memory() -> None:
    arrival_ns, payload = packets("velodyne")[40]
    later_us = [k * 553 - 1_000_000 for k in range(4000)]
    arrived = [(arrival_ns + us * 1000, shifted_velodyne(payload, us)) for us in later_us]
    result, _, counts = read(reader("velodyne"), arrived)
    assert result == []
    assert counts["sweeps.not_turning"] >= 1


def test_a_turn_that_cannot_be_a_sweep_is_not_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the reason: the turns after it are whole."""
    one = reader("ouster")
    half = packets("ouster")[: len(packets("ouster")) // 2]
    with monkeypatch.context() as broken:
        broken.setattr(one._cutter, "_sweep", Mock(side_effect=RuntimeError))
        with pytest.raises(RuntimeError):
            read(one, half, 10_000)
    result, *_ = read(one, packets("ouster")[len(half) :], 16)
    all_alike("ouster", result, 1)


@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_that_goes_on_at_an_earlier_time_gives_its_sweeps(kind: str) -> None:
    one = reader(kind)
    for _ in range(2):
        result, issues, counts = read(one, packets(kind))
        assert (len(result), issues) == (4, [])
    assert counts["packets.late"] == 0


def test_another_beam_table_would_be_noticed() -> None:
    """The test above can fail: a sensor whose beams stand 0.1° off gives other points."""
    metadata = json.loads(ouster_metadata())
    beams = metadata["beam_intrinsics"]
    beams["beam_altitude_angles"] = [angle + 0.1 for angle in beams["beam_altitude_angles"]]
    result, *_ = read(reader("ouster", metadata=json.dumps(metadata)), packets("ouster"))
    with pytest.raises(AssertionError):
        alike("ouster", result[0], sweeps("ouster")[0])
