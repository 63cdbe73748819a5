"""The native files of a simulated drive, its map, its truth and `drive.toml`.

rover.obs base.obs brdc.nav     RINEX 3.04
rover.ubx                       RXM-RAWX, RXM-SFRBX, NAV-PVT, NAV-HPPOSLLH
base.rtcm                       RTCM 3: 1005, MSM7, ephemerides
receiver.pos receiver.nmea      what the receiver solved by itself
receiver_arrivals.csv           when each part of receiver.pos was sent, by a correct clock
rover_arrivals.csv              the same for rover.obs
motion.csv suspension.csv ranging.csv imu.csv
sweeps/<time_ns>.pcd            one point cloud a turn
lidar.pcap lidar.json           the LiDAR's packets, and an Ouster's metadata, where a scenario asks for packets
can.log can.dbc sensors.toml    then also the CAN bus, and settings for `camber sensors` to read them
map/                            the release that a survey made
truth.csv                       the antenna, the vehicle, the road, the heights, which fix is wrong since when, faults
drive.toml                      the manifest
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.drive.motion_csv import write_samples
from camber.formats.drive.truth_csv import FIX_STATES, TruthTable, write_truth
from camber.formats.lidar_can.candump import candump_text
from camber.formats.map_exchange.pcd import write_sweep
from camber.formats.nmea.writer import format_gga, format_gst, format_rmc
from camber.formats.observations import Ephemeris
from camber.formats.receiver.phase_alignment import PhaseAlignment
from camber.formats.receiver.rtklib_pos import format_pos_header, format_pos_line
from camber.formats.rinex.writer import StationHeader, navigation_text, observation_lines
from camber.formats.rtcm.writer import format_ephemeris, format_observations, format_reference_station
from camber.formats.ubx.nav_writer import format_high_precision_position, format_position_velocity_time
from camber.formats.ubx.subframe_schedule import subframes_between
from camber.formats.ubx.writer import format_raw_measurements, format_subframe
from camber.geodesy.angles import wrap_pi_array
from camber.geodesy.ellipsoid import ecef_from_geodetic_scalar
from camber.replay.arrivals import write_arrivals
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Imu, Motion, Ranging, Suspension
from camber.simulator.injected_faults import ChangedRoad, WrongMap
from camber.simulator.output.can_frames import DBC, SETTINGS, can_frames
from camber.simulator.output.drive_manifest import manifest_text
from camber.simulator.output.lidar_packets import PATTERNS, ouster_metadata, pcap_of
from camber.simulator.satellites.atmosphere import KLOBUCHAR_ALPHA, KLOBUCHAR_BETA
from camber.simulator.satellites.orbits import newest_in_use
from camber.simulator.scene import Booleans, Floats, Integers
from camber.simulator.scene import Path as VehiclePath
from camber.simulator.simulated_drive import SENSORS, SimulatedDrive, offsets_by_link
from camber.simulator.vehicle.beam_pattern import BEAMS_32, BEAMS_64
from camber.simulator.vehicle.imu import imu_messages
from camber.simulator.vehicle.lidar import Scan, SimulatedLidar
from camber.simulator.vehicle.pose_track import PoseTrack
from camber.simulator.vehicle.sensors import motion_messages, ranging_messages, suspension_messages
from camber.simulator.vehicle.traffic import RoadUser, Traffic
from camber.simulator.world.survey import SURVEYED_BEFORE_NS, SurveyErrors, write_survey

GEOID_SEPARATION_M = (
    37.0  # of NMEA and UBX heights above the sea, about that of Nagoya; nothing in Camber rests on it
)
_STATION_ID = 1  # chosen
_OF_TRAJECTORY = (
    "road_height_m", "antenna_height_m", "stroke_m", "speed_m_s", "wheel_speed_m_s", "yaw_rate_rad_s", "steering_rad",
    "level", "link_id", "link_offset_m",
)  # fmt: skip
_THREADS = 2  # chosen: a simulation leaves the other cores alone


def write_drive(folder: Path, drive: SimulatedDrive) -> Iterator[str]:
    """Write all files, naming each part before it is made, each sweep after it. OSError where one cannot be written."""
    folder.mkdir(parents=True, exist_ok=True)
    yield "receiver"
    _write_rinex(folder, drive)
    _write_solutions(folder, drive)
    if drive.scenario.satellites.streams:
        yield "streams"
        (folder / "rover.ubx").write_bytes(b"".join(_ubx(drive)))
        (folder / "base.rtcm").write_bytes(b"".join(_rtcm(drive)))
    yield "sensors"
    if drive.scenario.motion:
        write_samples(folder / "motion.csv", Motion, motion_messages(drive.readings))
    if drive.imu is not None:
        write_samples(folder / "imu.csv", Imu, imu_messages(drive.imu))
    write_samples(folder / "ranging.csv", Ranging, ranging_messages(drive.readings, SENSORS, drive.body))
    strokes = suspension_messages(drive.readings, SENSORS)
    if strokes:
        write_samples(folder / "suspension.csv", Suspension, strokes)
    yield "truth"
    write_truth(folder / "truth.csv", truth_of(drive))
    yield "map"
    errors = SurveyErrors(clouds=drive.scenario.lidar is not None, wrong_m=drive.map_offset_m)
    surveyed_ns = drive.scenario.start_ns - SURVEYED_BEFORE_NS
    write_survey(folder / "map", drive.district, surveyed_ns, errors, scanned_route="default")
    if drive.scenario.lidar is not None:
        (folder / "sweeps").mkdir(exist_ok=True)
        yield from _write_sweeps(folder, drive)
    (folder / "drive.toml").write_bytes(manifest_text(drive).encode("utf-8"))


def _write_sweeps(folder: Path, drive: SimulatedDrive) -> Iterator[str]:
    lidar = drive.scenario.lidar
    assert lidar is not None
    done: list[str] = []

    def written() -> Iterator[Sweep]:
        for scan in scans_of(drive):
            write_sweep(folder / "sweeps", scan.sweep)
            done.append("sweep")
            yield scan.sweep

    if lidar.packets is None:
        for _ in written():
            yield done.pop()
        return
    write_can(folder, drive, lidar.packets)
    with (folder / "lidar.pcap").open("wb") as file:
        for piece in pcap_of(written(), lidar.packets):
            file.write(piece)
            while done:
                yield done.pop()


def write_can(folder: Path, drive: SimulatedDrive, packets: str) -> None:
    """The CAN bus, and settings for `camber sensors`."""
    (folder / "can.log").write_text(candump_text(can_frames(drive.readings)), "ascii")
    (folder / "can.dbc").write_text(DBC, "ascii")
    model, stamps = 'model = "HDL-32E"', "utc_hour"
    if packets == "ouster":
        (folder / "lidar.json").write_text(ouster_metadata(), "ascii")
        model, stamps = 'model = "ouster"\nmetadata = "lidar.json"', "tai"
    lidar = f'[lidar]\nsource = "pcap:lidar.pcap"\n{model}\nstamps = "{stamps}"\n\n'
    text = f"# For `camber sensors`, started in this folder.\n{lidar}{SETTINGS}"
    (folder / "sensors.toml").write_bytes(text.encode())


def parts_of(drive: SimulatedDrive) -> int:
    """How many parts `write_drive` names, about."""
    lidar = drive.scenario.lidar
    turns = int(drive.scenario.duration_s * 1e9 / BEAMS_64.turn_ns)
    return 4 + int(drive.scenario.satellites.streams) + (0 if lidar is None else turns)


def scans_of(drive: SimulatedDrive) -> Iterator[Scan]:
    """The sweeps of the drive's LiDAR, in order."""
    settings, scenario, path = drive.scenario.lidar, drive.scenario, drive.path
    assert settings is not None
    track = PoseTrack.of(drive.trajectory, drive.body, drive.body.lidar)
    users = _road_users(path, settings.traffic)
    pattern = BEAMS_64 if settings.beams == 64 else BEAMS_32
    lidar = SimulatedLidar(
        pattern=pattern if settings.packets is None else PATTERNS[settings.packets],
        track=track,
        tracer=drive.tracer,
        seed=scenario.seed,
        traffic=Traffic.of(users, int(track.time_ns[0]), int(track.time_ns[-1])),
        faults=scenario.faults,
    )
    return lidar.scans(_THREADS)


def _road_users(path: VehiclePath, count: int) -> list[RoadUser]:
    """Every other one comes towards the vehicle in the other lane, the rest drive ahead and do not stop."""
    length_m = path.step_m * (len(path.east_m) - 1)
    users = []
    for k in range(count):
        if k % 2:
            users.append(RoadUser(path=path, start_m=40.0 + 60.0 * k, speed_m_s=9.0 + 0.5 * k))
        else:
            start_m = length_m * (k + 1) / (count + 1)
            users.append(RoadUser(path=path, start_m=start_m, speed_m_s=-8.0 - 0.5 * k, left_m=-3.4))
    return users


def truth_of(drive: SimulatedDrive) -> TruthTable:
    """The truth at the receiver's epochs."""
    t, rows, frame = drive.trajectory, drive.of_epoch, drive.district.frame
    antenna_m, origin_m = t.antenna_m[rows], t.origin_m[rows]
    latitude, longitude, _ = frame.geodetic_from_east_north_array(antenna_m[:, :2], antenna_m[:, 2])
    at_axle = frame.geodetic_from_east_north_array(origin_m[:, :2], origin_m[:, 2])
    states = np.where(drive.fixed, np.where(drive.fix_wrong, "wrong", "right"), "none")
    time_s = (drive.epoch_ns - drive.epoch_ns[0]) / 1e9
    links = t.link_id[rows].tolist()

    more: dict[str, Floats] = {
        "vehicle_latitude_deg": np.degrees(at_axle[0]),
        "vehicle_longitude_deg": np.degrees(at_axle[1]),
        "vehicle_height_m": origin_m[:, 2],
        **{name: getattr(t, name)[rows].astype(np.float64) for name in _OF_TRAJECTORY},
        "road_changed_m": np.array([drive.district.changed_roads.get(link, 0.0) for link in links]),
        "map_wrong_m": np.array([drive.map_offset_m.get(link, 0.0) for link in links]),
        "fix_wrong_since_s": np.where(drive.fix_wrong, _since(drive.fix_wrong, drive.epoch_ns), np.nan),
        "fix_integers_wrong": np.where(drive.fixed, drive.solutions.wrong_integers, np.nan),
    }
    for fault in drive.scenario.faults:
        name = f"fault_{fault.kind}"
        if isinstance(fault, ChangedRoad | WrongMap):  # a link is changed as a whole
            acts = np.isin(t.link_id[rows], list(offsets_by_link([fault], t)))
        else:
            acts = fault.acts(time_s)
        more[name] = np.maximum(more.get(name, np.zeros(len(rows))), acts)
    return TruthTable(
        time_ns=drive.epoch_ns,
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=antenna_m[:, 2],
        roll_rad=t.roll_rad[rows],
        pitch_rad=t.pitch_rad[rows],
        yaw_rad=wrap_pi_array(t.yaw_rad[rows]),
        velocity_enu_m_s=t.antenna_velocity_m_s[rows],
        fix_state=np.array([FIX_STATES.index(state) for state in states.tolist()], np.int8),
        more=more,
    )


def _since(on: Booleans, time_ns: Integers) -> Floats:
    """Seconds since the first epoch at which each stretch of `on` began."""
    begins = np.flatnonzero(on & ~np.concatenate(([False], on[:-1])))
    place = np.searchsorted(begins, np.arange(len(on)), side="right") - 1
    seconds = (time_ns - time_ns[0]) / 1e9
    return np.where(on, seconds[begins[np.maximum(place, 0)]] if len(begins) else np.nan, np.nan)


def _write_rinex(folder: Path, drive: SimulatedDrive) -> None:
    rover = [
        (one.arrival_ns, one.rover)
        for one in drive.outputs
        if one.rover is not None and len(one.rover.satellite)
    ]
    near = ecef_from_geodetic_scalar(*_geodetic(drive, drive.trajectory.antenna_m[0]))
    station = StationHeader(marker="rover", position_ecef_m=near)
    lines = [line.encode("ascii") for line in observation_lines([epoch for _, epoch in rover], station)]
    times_ns = [arrival_ns for arrival_ns, _ in rover]
    _write_with_arrivals(folder / "rover.obs", lines[0], times_ns, lines[1:])
    with (folder / "base.obs").open("w", encoding="ascii", newline="\n") as file:
        station = StationHeader(
            marker="base", position_ecef_m=base_ecef_m(drive, drive.frame_offset_m), marker_type="GEODETIC"
        )
        file.writelines(observation_lines(list(drive.base), station))
    ionosphere = IonosphereCoefficients(system="G", alpha=KLOBUCHAR_ALPHA, beta=KLOBUCHAR_BETA)
    (folder / "brdc.nav").write_text(navigation_text(drive.broadcast, [ionosphere]), "ascii", newline="\n")


def _write_with_arrivals(path: Path, header: bytes, times_ns: list[int], parts: list[bytes]) -> None:
    """A file of the receiver, and when each of its parts was sent; the header with the first."""
    path.write_bytes(b"".join((header, *parts)))
    lengths = [len(part) for part in parts]
    lengths[0] += len(header)
    arrivals = list(zip(times_ns, lengths, strict=True))
    write_arrivals(path.with_name(f"{path.stem}_arrivals.csv"), arrivals)


def base_ecef_m(drive: SimulatedDrive, offset_m: Floats | None = None) -> tuple[float, float, float]:
    """The base station, or where its coordinates say that it is."""
    place = np.array(drive.base_m) + (0.0 if offset_m is None else offset_m)
    return ecef_from_geodetic_scalar(*_geodetic(drive, place))


def _geodetic(drive: SimulatedDrive, place_m: Floats) -> tuple[float, float, float]:
    east_m, north_m, up_m = place_m.tolist()
    latitude, longitude, _ = drive.district.frame.geodetic_from_east_north(east_m, north_m, up_m)
    return latitude, longitude, up_m


def _write_solutions(folder: Path, drive: SimulatedDrive) -> None:
    times_ns, lines, sentences = list[int](), list[bytes](), list[bytes]()
    for one in drive.outputs:
        if one.solution is not None:
            times_ns.append(one.arrival_ns)
            lines.append(format_pos_line(one.solution))
            sentences.append(format_gga(one.solution, geoid_separation_m=GEOID_SEPARATION_M))
            sentences.append(format_rmc(one.solution))
            if one.solution.covariance_enu_m2 is not None:
                sentences.append(format_gst(one.solution))
    _write_with_arrivals(folder / "receiver.pos", format_pos_header(), times_ns, lines)
    (folder / "receiver.nmea").write_bytes(b"".join(sentences))


def _ubx(drive: SimulatedDrive) -> Iterator[bytes]:
    """In the order of time: raw measurements, subframes as they end, the receiver's position."""
    epochs = [one.rover for one in drive.outputs if one.rover is not None]
    seen = {int(s) for epoch in epochs for s in np.unique(epoch.satellite)}
    begin_ns, end_ns = int(drive.epoch_ns[0]), int(drive.epoch_ns[-1])
    subframes = [
        subframe
        for ephemeris in _newest(drive)
        if ephemeris.satellite in seen
        for subframe in subframes_between(ephemeris, begin_ns, end_ns)
    ]
    waiting = deque(sorted(subframes, key=lambda one: (one.end_ns, one.satellite)))
    counts = PhaseAlignment()
    for one in drive.outputs:
        if one.rover is not None:
            while waiting and waiting[0].end_ns <= one.rover.time_ns:
                yield format_subframe(waiting.popleft())
            yield format_raw_measurements(counts.align_to_pseudorange(one.rover))
        if one.solution is not None:
            yield format_position_velocity_time(one.solution, geoid_separation_m=GEOID_SEPARATION_M)
            yield format_high_precision_position(one.solution, geoid_separation_m=GEOID_SEPARATION_M)


def _rtcm(drive: SimulatedDrive) -> Iterator[bytes]:
    """Observations at the base's rate, its place and the ephemerides every ten seconds."""
    offsets = dict(zip(drive.epoch_ns.tolist(), drive.base_offset_m, strict=True))
    ephemerides = [frame for ephemeris in _newest(drive) for frame in format_ephemeris(ephemeris)]
    every = 10 * drive.scenario.satellites.rate_hz
    sent_m: tuple[float, ...] = ()
    counts = PhaseAlignment()
    for number, epoch in enumerate(drive.base):
        place_m = base_ecef_m(drive, offsets[epoch.time_ns])
        if number % every == 0 or place_m != sent_m:
            sent_m = place_m
            yield format_reference_station(place_m, station_id=_STATION_ID)
        if number % every == 0:
            yield from ephemerides
        yield from format_observations(counts.align_to_pseudorange(epoch), station_id=_STATION_ID)


def _newest(drive: SimulatedDrive) -> list[Ephemeris]:
    return newest_in_use(drive.broadcast, int(drive.epoch_ns[0]))
