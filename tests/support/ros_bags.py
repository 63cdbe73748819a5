"""ROS bags for tests: of messages, of a drive folder, and point clouds in the layouts of makers' drivers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from camber.formats.drive.motion_csv import read_samples
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.ros.message_types import definition_text
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.replay.sweep_files import sweep_files
from camber.schemas.drive import load_manifest
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Imu, LeverArm, Motion

POINT_CLOUD2 = "sensor_msgs/msg/PointCloud2"
BagKind = Literal["mcap", "sqlite3", "ros1"]
NS = 1_000_000_000
STATUS_OF_QUALITY = {
    SolutionQuality.SINGLE: 0,
    SolutionQuality.SBAS: 1,
    SolutionQuality.DGPS: 18,
    SolutionQuality.FIX: 19,
    SolutionQuality.FLOAT: 20,
}
"""As GPSStatus has it; a NavSatFix of both, FIX and FLOAT, is GBAS_FIX (2)."""
_GPS = ("gps_msgs/msg/GPSStatus", "gps_msgs/msg/GPSFix", "rtcm_msgs/msg/Message", "mavros_msgs/msg/RTCM")
LIVOX = "livox_ros_driver2/msg/CustomMsg"
LIVOX_ROS1 = "livox_ros_driver/msg/CustomMsg"
_DATATYPES = {"u1": 2, "u2": 4, "u4": 6, "f4": 7, "f8": 8}


class BagWriter:
    """Writes messages into a bag; `receive_unix_ns` is the time of recording."""

    def __init__(self, kind: BagKind, writer: Any) -> None:
        self._writer, self._ros1 = writer, kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self._ros1 else Stores.ROS2_HUMBLE)
        for name in _GPS:
            self.store.register(get_types_from_msg(definition_text(name), name))
        for package in ("livox_ros_driver2", "livox_ros_driver"):
            for name in ("CustomPoint", "CustomMsg"):
                text = definition_text(f"livox_ros_driver2/msg/{name}")
                self.store.register(get_types_from_msg(text, f"{package}/msg/{name}"))
        if self._ros1:
            frames = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(frames, "tf2_msgs/msg/TFMessage"))
        self._connections: dict[str, Any] = {}

    def new(self, kind: str, /, **values: Any) -> Any:
        cls: Any = self.store.types[kind]
        return cls(**values)

    def header(self, unix_ns: int, frame_id: str) -> Any:
        seconds, nanoseconds = divmod(unix_ns, NS)
        stamp = self.new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        sequence = {"seq": 0} if self._ros1 else {}
        return self.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id, **sequence)

    def write(self, topic: str, kind: str, receive_unix_ns: int, message: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self._ros1 else self.store.serialize_cdr
        self._writer.write(self._connections[topic], receive_unix_ns, serialize(message, kind))

    def twist(self, topic: str, unix_ns: int, speed_m_s: float, yaw_rate_rad_s: float) -> None:
        """A TwistStamped, recorded as it was measured."""

        def vector(x: float, z: float) -> Any:
            return self.new("geometry_msgs/msg/Vector3", x=x, y=0.0, z=z)

        twist = self.new(
            "geometry_msgs/msg/Twist", linear=vector(speed_m_s, 0.0), angular=vector(0.0, yaw_rate_rad_s)
        )
        header = self.header(unix_ns, "base_link")
        kind = "geometry_msgs/msg/TwistStamped"
        self.write(topic, kind, unix_ns, self.new(kind, header=header, twist=twist))

    def imu(self, topic: str, unix_ns: int, sample: Imu, **changes: Any) -> None:
        """An Imu without orientation, recorded as it was measured."""

        def vector(values: tuple[float, float, float]) -> Any:
            return self.new("geometry_msgs/msg/Vector3", **dict(zip("xyz", values, strict=True)))

        kind, unknown = "sensor_msgs/msg/Imu", np.zeros(9)
        values = {
            "header": self.header(unix_ns, "imu"),
            "orientation": self.new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            "orientation_covariance": np.array([-1.0, *[0.0] * 8]),
            "angular_velocity": vector(sample.angular_rate_rad_s),
            "angular_velocity_covariance": unknown,
            "linear_acceleration": vector(sample.specific_force_m_s2),
            "linear_acceleration_covariance": unknown,
        }
        self.write(topic, kind, unix_ns, self.new(kind, **values | changes))

    def nav_sat_fix(self, topic: str, unix_ns: int, solution: ReceiverSolution, **changes: Any) -> None:
        status = min(STATUS_OF_QUALITY[solution.quality], 2)
        kind = "sensor_msgs/msg/NavSatFix"
        values = {
            "header": self.header(unix_ns, "gps"),
            "status": self.new("sensor_msgs/msg/NavSatStatus", status=status, service=1),
            **_place(solution),
        }
        self.write(topic, kind, unix_ns, self.new(kind, **values | changes))

    def gps_fix(self, topic: str, unix_ns: int, solution: ReceiverSolution) -> None:
        kind, none = "gps_msgs/msg/GPSFix", np.empty(0, np.int32)
        status = self.new(
            "gps_msgs/msg/GPSStatus",
            header=self.header(unix_ns, "gps"),
            satellites_used=solution.satellites or 0,
            **dict.fromkeys(
                ("satellite_used_prn", "satellite_visible_prn", "satellite_visible_z",
                 "satellite_visible_azimuth", "satellite_visible_snr"), none),
            **dict.fromkeys(
                ("satellites_visible", "motion_source", "orientation_source", "position_source"), 0),
            status=STATUS_OF_QUALITY[solution.quality],
        )  # fmt: skip
        fields = self.store.fielddefs[kind][1]
        rest = {name: 0.0 for name, (_, of) in fields if of == ("float64", 0)}
        header = self.header(unix_ns, "gps")
        self.write(
            topic,
            kind,
            unix_ns,
            self.new(kind, **rest | {"header": header, "status": status} | _place(solution)),
        )

    def point_cloud(self, topic: str, unix_ns: int, stamp_unix_ns: int, fields: Mapping[str, Any]) -> None:
        """A PointCloud2 of `fields` as `cloud_fields` gives them, recorded at `unix_ns`."""
        self.write(topic, POINT_CLOUD2, unix_ns, self.cloud_message(stamp_unix_ns, fields))

    def cloud_message(self, stamp_unix_ns: int, fields: Mapping[str, Any]) -> Any:
        return self.new(
            POINT_CLOUD2,
            header=self.header(stamp_unix_ns, "lidar"),
            fields=[
                self.new("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=datatype, count=1)
                for name, offset, datatype in fields["fields"]
            ],
            **{name: value for name, value in fields.items() if name != "fields"},
        )

    def livox_message(self, sweep: Sweep, kind: str = LIVOX) -> Any:
        """A sweep as Livox's driver publishes it: whole intensities up to 255."""
        at_ns = unix_ns_from_gps_ns(sweep.time_ns) + sweep.offset_ns.astype(np.int64)
        begin_ns = int(at_ns.min())
        columns = zip(at_ns - begin_ns, sweep.points_m, sweep.intensity, strict=True)
        points = [
            self.new(
                kind.replace("CustomMsg", "CustomPoint"),
                offset_time=int(after_ns),
                **dict(zip("xyz", map(float, xyz), strict=True)),
                reflectivity=int(intensity),
                tag=16,
                line=k % 4,
            )
            for k, (after_ns, xyz, intensity) in enumerate(columns)
        ]
        return self.new(
            kind,
            header=self.header(begin_ns, "livox_frame"),
            timebase=begin_ns,
            point_num=len(points),
            lidar_id=0,
            rsvd=np.zeros(3, np.uint8),
            points=points,
        )

    def static_transforms(
        self, unix_ns: int, places: Mapping[str, LeverArm], turns: Mapping[str, float]
    ) -> None:
        """Of frames below base_link, turned about z by so many radians."""
        transforms = [
            self.new(
                "geometry_msgs/msg/TransformStamped",
                header=self.header(unix_ns, "base_link"),
                child_frame_id=frame,
                transform=self.new(
                    "geometry_msgs/msg/Transform",
                    translation=self.new("geometry_msgs/msg/Vector3", x=arm.x_m, y=arm.y_m, z=arm.z_m),
                    rotation=self.new(
                        "geometry_msgs/msg/Quaternion",
                        x=0.0,
                        y=0.0,
                        z=math.sin(0.5 * turns.get(frame, 0.0)),
                        w=math.cos(0.5 * turns.get(frame, 0.0)),
                    ),
                ),
            )
            for frame, arm in places.items()
        ]
        kind = "tf2_msgs/msg/TFMessage"
        self.write("/tf_static", kind, unix_ns, self.new(kind, transforms=transforms))

    def raw(self, topic: str, unix_ns: int, data: bytes) -> None:
        """Bytes as a UInt8MultiArray."""
        kind = "std_msgs/msg/UInt8MultiArray"
        layout = self.new("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
        self.write(
            topic, kind, unix_ns, self.new(kind, layout=layout, data=np.frombuffer(data, np.uint8).copy())
        )


@contextmanager
def bag_writer(path: Path, kind: BagKind = "mcap") -> Iterator[BagWriter]:
    """A new bag: a folder, or for ROS 1 the file."""
    if kind == "ros1":
        with Ros1Writer(path) as writer:
            yield BagWriter(kind, writer)
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        with Ros2Writer(path, version=8, storage_plugin=plugin) as writer:
            yield BagWriter(kind, writer)


def write_drive_bag(
    manifest_path: Path,
    path: Path,
    kind: BagKind = "mcap",
    *,
    maker: str = "ouster",
    lidar_turn_rad: float = 0.0,
) -> Path:
    """What of a drive folder ROS has messages for: GPSFix, TwistStamped, sweeps, lever arms; in the order of time."""
    manifest = load_manifest(manifest_path)
    items: list[tuple[int, Any]] = []
    if manifest.motion is not None:
        items += [(sample.time_ns, sample) for sample in read_samples(manifest.motion.file, Motion)]
    if manifest.receiver is not None:
        decoded = PosDecoder("receiver").feed(manifest.receiver.file.read_bytes())
        items += [(one.time_ns, one) for one in decoded if isinstance(one, ReceiverSolution)]
    if manifest.sweeps is not None:
        items += [(file.time_ns, file.read()) for file in sweep_files(manifest.sweeps.folder)[0]]
    items.sort(key=lambda item: item[0])
    arms = {"gps": manifest.lever_arms.antenna, "lidar": manifest.lever_arms.lidar}
    with bag_writer(path, kind) as bag:
        bag.static_transforms(unix_ns_from_gps_ns(items[0][0]), arms, {"lidar": lidar_turn_rad})
        for time_ns, item in items:
            unix_ns = unix_ns_from_gps_ns(time_ns)
            if isinstance(item, ReceiverSolution):
                bag.gps_fix("/gps", unix_ns, item)
            elif isinstance(item, Motion):
                known = [item.wheel_speed_m_s, item.yaw_rate_rad_s]
                bag.twist("/twist", unix_ns, *(math.nan if value is None else value for value in known))
            else:
                stamp_ns, fields = cloud_fields(turned(item, -lidar_turn_rad), maker)
                bag.point_cloud("/points", unix_ns, stamp_ns, fields)
    return path


def turned(sweep: Sweep, about_z_rad: float) -> Sweep:
    """A sweep in a frame with other axes."""
    if not about_z_rad:
        return sweep
    c, s = math.cos(about_z_rad), math.sin(about_z_rad)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return sweep.model_copy(update={"points_m": (sweep.points_m @ turn.T).astype(np.float32)})


MAKERS = ("ouster", "velodyne", "hesai", "robosense", "livox")
_BEAMS = 16


def cloud_message(sweep: Sweep, maker: str, **options: bool) -> Any:
    """A sweep as the PointCloud2 of a maker's driver."""
    return BagWriter("mcap", None).cloud_message(*cloud_fields(sweep, maker, **options))


def point_cloud2_bytes(sweep: Sweep, maker: str, **options: bool) -> bytes:
    """The same as CDR."""
    message = cloud_message(sweep, maker, **options)
    return bytes(BagWriter("mcap", None).store.serialize_cdr(message, POINT_CLOUD2))


def livox_bytes(sweep: Sweep) -> bytes:
    """A sweep as Livox's CustomMsg, as CDR."""
    writer = BagWriter("mcap", None)
    return bytes(writer.store.serialize_cdr(writer.livox_message(sweep), LIVOX))


def cloud_fields(sweep: Sweep, maker: str, *, big_endian: bool = False) -> tuple[int, dict[str, Any]]:
    """Stamp and fields of a sweep as the driver of a maker publishes it.

    ouster      organised, padded fields, `t` after the stamp, a point without return is zero; stamp: begin
    velodyne    `time` in seconds before the stamp; stamp: end
    hesai       organised, `timestamp` in absolute seconds, a point without return is NaN; stamp: begin
    robosense   the same with `ring` between, not organised
    livox       `timestamp` in absolute nanoseconds as a double; stamp: begin
    """
    n = len(sweep.points_m)
    end_ns = unix_ns_from_gps_ns(sweep.time_ns)
    at_ns = end_ns + sweep.offset_ns.astype(np.int64)
    begin_ns = int(at_ns.min())
    after_ns = at_ns - begin_ns
    seconds = begin_ns // NS + ((begin_ns % NS) + after_ns) / NS
    order = ">" if big_endian else "<"
    stamp_ns = end_ns if maker == "velodyne" else begin_ns
    layouts: dict[str, tuple[dict[str, tuple[str, int]], int, dict[str, Any]]] = {
        "ouster": ({"x": ("f4", 0), "y": ("f4", 4), "z": ("f4", 8), "intensity": ("f4", 16), "t": ("u4", 20),
                    "reflectivity": ("u2", 24), "ring": ("u2", 26), "range": ("u4", 32)}, 48, {"t": after_ns}),
        "velodyne": ({"x": ("f4", 0), "y": ("f4", 4), "z": ("f4", 8), "intensity": ("f4", 12), "ring": ("u2", 16),
                      "time": ("f4", 18)}, 22, {"time": (at_ns - end_ns) / NS}),
        "hesai": ({"x": ("f4", 0), "y": ("f4", 4), "z": ("f4", 8), "intensity": ("f4", 16),
                   "timestamp": ("f8", 24), "ring": ("u2", 32)}, 48, {"timestamp": seconds}),
        "robosense": ({"x": ("f4", 0), "y": ("f4", 4), "z": ("f4", 8), "intensity": ("f4", 12), "ring": ("u2", 16),
                       "timestamp": ("f8", 18)}, 26, {"timestamp": seconds}),
        "livox": ({"x": ("f4", 0), "y": ("f4", 4), "z": ("f4", 8), "intensity": ("f4", 12), "tag": ("u1", 16),
                   "line": ("u1", 17), "timestamp": ("f8", 18)}, 26, {"timestamp": at_ns.astype(np.float64)}),
    }  # fmt: skip
    fields, step, times = layouts[maker]
    organised = maker in ("ouster", "hesai")
    rows = -(-n // _BEAMS) * _BEAMS if organised else n
    kinds = [(order + kind) for kind, _ in fields.values()]
    row = np.dtype(
        {
            "names": list(fields),
            "formats": kinds,
            "offsets": [at for _, at in fields.values()],
            "itemsize": step,
        }
    )
    data = np.zeros(rows, row)
    if maker == "hesai":
        for axis in "xyz":
            data[axis][n:] = np.nan
        data["timestamp"] = seconds[0] if n else 0.0
    for axis, column in zip("xyz", sweep.points_m.T, strict=True):
        data[axis][:n] = column
    data["intensity"][:n] = sweep.intensity
    for name, values in times.items():
        data[name][:n] = values
    height, width, padding = 1, rows, 0
    content = data.tobytes()
    if organised:  # row by row, a beam each, with bytes after each row
        height, width, padding = _BEAMS, rows // _BEAMS, 8
        by_beam = data.reshape(width, _BEAMS).T
        content = b"".join(line.tobytes() + bytes(padding) for line in by_beam)
    return stamp_ns, {
        "height": height,
        "width": width,
        "fields": [(name, at, _DATATYPES[kind]) for name, (kind, at) in fields.items()],
        "is_bigendian": big_endian,
        "point_step": step,
        "row_step": width * step + padding,
        "data": np.frombuffer(content, np.uint8).copy(),
        "is_dense": not organised,
    }


def _place(solution: ReceiverSolution) -> dict[str, Any]:
    matrix = np.zeros((3, 3))
    if solution.covariance_enu_m2 is not None:
        matrix[np.triu_indices(3)] = solution.covariance_enu_m2
        matrix = np.triu(matrix) + np.triu(matrix, 1).T
    return {
        "latitude": math.degrees(solution.latitude_rad),
        "longitude": math.degrees(solution.longitude_rad),
        "altitude": solution.height_m,
        "position_covariance": matrix.reshape(-1),
        "position_covariance_type": 0 if solution.covariance_enu_m2 is None else 3,
    }
