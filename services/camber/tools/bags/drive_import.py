"""The files of a drive, written from the messages of a bag as they come."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from io import BufferedWriter
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from camber.formats.drive.motion_csv import IMU_COLUMNS, MOTION_COLUMNS, sample_header, sample_line
from camber.formats.errors import FormatError
from camber.formats.map_exchange.pcd import write_sweep
from camber.formats.receiver.rtklib_pos import format_pos_header, format_pos_line
from camber.formats.receiver.solution import SolutionQuality
from camber.formats.ros.bag_reader import Bag, BagMessage, BagTopic, StampCheck
from camber.formats.ros.message_types import stamp_unix_ns
from camber.formats.ros.point_cloud2 import PointLayout, point_cloud2, point_layout, sweep_from_point_cloud2
from camber.formats.ros.sensor_messages import imu_of, motion_of, solution_of
from camber.formats.ros.static_frames import StaticFrames
from camber.schemas.base import Float64
from camber.schemas.refused_field import first_refused
from camber.tools.bags.raw_bytes import RawBytes
from camber.tools.bags.topic_choice import BYTES_TYPES, TF_STATIC, DriveTopics

SENSOR = "lidar"
SWEEPS, POSITIONS, MOTION, IMU = "sweeps", "receiver.pos", "motion.csv", "imu.csv"
_SAME_AXES = 1e-9  # chosen: rounding of a quaternion


@dataclass(slots=True, kw_only=True)
class TopicTally:
    """What became of the messages of a topic. `frame_id` is that of the first message taken."""

    topic: BagTopic
    taken: int = 0
    left_out: int = 0
    first_fault: FormatError | None = None
    frame_id: str = ""
    qualities: Counter[SolutionQuality] = field(default_factory=Counter)
    layout: PointLayout | None = None
    turned: bool = False
    """The points were turned into the axes of the base frame."""
    delays_ns: array[int] = field(default_factory=lambda: array("q"))

    @property
    def delay_s(self) -> float:
        """Median of recording time less stamp."""
        return float(np.median(np.frombuffer(self.delays_ns, np.int64))) / 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveParts:
    """What was written, and what of the vehicle the bag contains."""

    topics: DriveTopics
    tallies: dict[str, TopicTally]
    raw: RawBytes
    frames: StaticFrames
    base_frame: str

    def tally(self, topic: BagTopic | None) -> TopicTally | None:
        """Return the tally of a topic of which something was taken."""
        tally = None if topic is None else self.tallies[topic.name]
        return tally if tally is not None and tally.taken else None

    def base_from(self, frame_id: str) -> Float64 | None:
        """Return the transform (4, 4) from a frame to the base frame; None where it is not known."""
        return self.frames.base_from(self.base_frame, frame_id) if frame_id else None


def static_frames(bag: Bag) -> StaticFrames:
    """Return the static transforms of a bag."""
    frames = StaticFrames()
    for message in bag.messages({TF_STATIC}):
        content = bag.decode(message)
        try:
            frames.add(content)
        except ValueError as error:
            raise FormatError(TF_STATIC, "transforms", f"rigid motions: {error}") from None
    return frames


def write_drive_files(
    bag: Bag, parts: DriveParts, folder: Path, *, progress: Callable[[], object] = lambda: None
) -> None:
    """Write sweeps, receiver.pos, motion.csv, imu.csv and raw files; the tallies say what was taken.

    `progress` is called after each message. Raises FormatError where a topic has no usable message or the bag is
    damaged, OSError.
    """
    topics = parts.topics
    with closing(parts.raw), _files(folder, topics) as streams:
        checks = {name: StampCheck(name) for name in topics.names}
        for message in bag.messages(topics.names):
            tally = parts.tallies[message.topic]
            try:
                taken = _take(bag, message, checks[message.topic], parts=parts, streams=streams)
            except FormatError as error:
                tally.left_out += 1
                tally.first_fault = tally.first_fault or error
            else:
                tally.taken += taken
            progress()
    for tally in parts.tallies.values():
        if tally.first_fault is not None and not tally.taken:
            raise tally.first_fault
    if not any(tally.taken for tally in parts.tallies.values()):
        expected = "a position, a sample of motion or an IMU, a sweep or a frame of UBX or RTCM 3"
        raise FormatError(", ".join(topics.names), "messages", expected)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Streams:
    sweeps: Path
    positions: BufferedWriter | None
    motion: BufferedWriter | None
    imu: BufferedWriter | None


@contextmanager
def _files(folder: Path, topics: DriveTopics) -> Iterator[_Streams]:
    with ExitStack() as stack:

        def opened(name: str, header: bytes) -> BufferedWriter:
            stream = stack.enter_context((folder / name).open("wb"))
            stream.write(header)
            return stream

        if topics.lidar is not None:
            (folder / SWEEPS).mkdir()
        positions_header = format_pos_header(ambiguities=False)
        motion_header = sample_header(MOTION_COLUMNS).encode()
        yield _Streams(
            sweeps=folder / SWEEPS,
            positions=None if topics.receiver is None else opened(POSITIONS, positions_header),
            motion=None if topics.odometry is None else opened(MOTION, motion_header),
            imu=None if topics.imu is None else opened(IMU, sample_header(IMU_COLUMNS).encode()),
        )


def _take(bag: Bag, message: BagMessage, check: StampCheck, *, parts: DriveParts, streams: _Streams) -> bool:
    """Write what a message has, and return whether there was something. Raises FormatError."""
    content, tally = bag.decode(message), parts.tallies[message.topic]
    if message.kind in BYTES_TYPES:
        before = sum(file.frames for file in parts.raw.files)
        parts.raw.add(message.topic, np.asarray(getattr(content, BYTES_TYPES[message.kind])).tobytes())
        return sum(file.frames for file in parts.raw.files) > before
    time_ns = check.gps_time_ns(content, message.receive_unix_ns)
    tally.delays_ns.append(message.receive_unix_ns - stamp_unix_ns(content))
    if tally.topic == parts.topics.lidar:
        _write_sweep(content, tally, parts=parts, folder=streams.sweeps)
    elif tally.topic == parts.topics.receiver:
        solution = solution_of(content, time_ns, message.kind, message.topic)
        if solution is None or streams.positions is None:
            return False
        try:
            streams.positions.write(format_pos_line(solution, ambiguities=False))
        except ValueError as error:
            raise FormatError(message.topic, "position", f"finite numbers: {error}") from None
        tally.qualities[solution.quality] += 1
    elif not _write_sample(content, time_ns, tally.topic, parts=parts, streams=streams):
        return False
    tally.frame_id = tally.frame_id or getattr(content, "child_frame_id", content.header.frame_id)
    return True


def _write_sweep(content: Any, tally: TopicTally, *, parts: DriveParts, folder: Path) -> None:
    cloud = point_cloud2(content, tally.topic.kind)
    layout = point_layout(cloud, tally.topic.name)
    sweep = sweep_from_point_cloud2(cloud, layout, tally.topic.name, SENSOR)
    base_from_sensor = parts.base_from(content.header.frame_id)
    if base_from_sensor is not None and np.abs(base_from_sensor[:3, :3] - np.eye(3)).max() > _SAME_AXES:
        turned = (sweep.points_m @ base_from_sensor[:3, :3].T).astype(np.float32)
        sweep, tally.turned = sweep.model_copy(update={"points_m": turned}), True
    if (folder / f"{sweep.time_ns}.pcd").exists():
        raise FormatError(tally.topic.name, "header.stamp", "another time than that of an earlier sweep")
    write_sweep(folder, sweep)
    tally.layout = tally.layout or layout


def _write_sample(
    content: Any, time_ns: int, topic: BagTopic, *, parts: DriveParts, streams: _Streams
) -> bool:
    """Write a sample of the odometry or of the inertial measurement unit."""
    is_imu = topic == parts.topics.imu
    stream, columns = (streams.imu, IMU_COLUMNS) if is_imu else (streams.motion, MOTION_COLUMNS)
    try:
        sample = imu_of(content, time_ns, topic.name) if is_imu else motion_of(content, time_ns)
    except ValidationError as error:
        field = first_refused(error, whole="message")
        raise FormatError(topic.name, field.name, field.expected, actual=field.value) from None
    if sample is None or stream is None:
        return False
    stream.write(sample_line(sample, columns).encode())
    return True
