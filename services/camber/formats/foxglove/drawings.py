"""What viewers draw of a vehicle's messages, as Foxglove's messages beside ours.

    /gnss/fix/location             LocationFix   tentative fixes, grey
    /integrity/verdict/location    LocationFix   the fixes judged: confirmed green, erroneous red, unknown amber
    /integrity/position/location   LocationFix   what consumers use: usable blue, otherwise amber
    /integrity/position/track      GeoJSON       the track so far, by whether it was usable
    /integrity/position/levels     SceneUpdate   horizontal protection level and alert limit, to scale
    /localizer/pose/location       LocationFix   the approximate position of the antenna
    /localizer/pose/in_local       PoseInFrame   the same in the frame `local`, whose origin is the first pose
    /transforms                    FrameTransform  from `local` to `vehicle`
    /log                           Log           erroneous fixes with their reason; when positions become usable or not

Heights are ellipsoidal. A pose has its height from the road of the map; where that is not known it is drawn at the last
height that was. Frame `local` is east, north, up.
"""

from __future__ import annotations

import json
import math
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from camber.formats.foxglove.protobuf import encode
from camber.geodesy.angles import heading_from_yaw
from camber.geodesy.gps_time import NS_PER_SECOND, unix_ns_from_gps_ns
from camber.geodesy.horizontal_offsets import east_north_between
from camber.geodesy.local_frame import LocalFrame
from camber.schemas.base import Message
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Position, Verdict
from camber.schemas.pose import Pose

_GREY, _GREEN, _RED, _AMBER, _BLUE = (
    {"r": r, "g": g, "b": b, "a": 1.0}
    for r, g, b in ((0.6, 0.6, 0.6), (0.1, 0.7, 0.3), (0.9, 0.1, 0.1), (1.0, 0.7, 0.0), (0.1, 0.4, 0.9))
)
_COVARIANCE_KNOWN, _INFO, _WARNING = 3, 2, 3  # of LocationFix and Log
_FIXES_KEPT = 256  # chosen: a verdict comes within seconds of its fix
_TRACK_EVERY_NS = 10 * NS_PER_SECOND  # chosen: the whole track each time
_TRACK_STEP_M = 5.0  # chosen: seen on a map of a city
_TRACK_POINTS = 500  # chosen: 20 kB; beyond it every other point is left out
_LEVEL_THICKNESS_M = 0.02  # chosen: a disc on the road


class Drawing(NamedTuple):
    """One message of Foxglove: topic, name of the message, and its bytes."""

    topic: str
    schema: str
    data: bytes


class Drawings:
    """Draws one vehicle's messages; they come in the order of time."""

    def __init__(self) -> None:
        self._fixes: OrderedDict[int, Fix] = OrderedDict()
        self._frame: LocalFrame | None = None
        self._height_m = 0.0
        self._usable: bool | None = None
        self._track = _Track()
        self._of: dict[type[Message], Callable[[Any], Iterator[Drawing]]] = {
            Fix: self._fix,
            Verdict: self._verdict,
            Position: self._position,
            Pose: self._pose,
        }
        self.schemas = frozenset(cls.schema_name() for cls in self._of)
        """Of the messages of which something is drawn."""

    def of(self, message: Message) -> Iterator[Drawing]:
        """Yield what is drawn of a message."""
        draw = self._of.get(type(message))
        return iter(()) if draw is None else draw(message)

    def _fix(self, fix: Fix) -> Iterator[Drawing]:
        self._fixes[fix.fix_id] = fix
        while len(self._fixes) > _FIXES_KEPT:
            self._fixes.popitem(last=False)
        yield _location("/gnss/fix/location", fix, _GREY, {"quality": fix.quality})

    def _verdict(self, verdict: Verdict) -> Iterator[Drawing]:
        fix = None if verdict.fix_id is None else self._fixes.get(verdict.fix_id)
        if fix is not None:
            colour = {"erroneous": _RED, "unknown": _AMBER}.get(verdict.verdict, _GREEN)
            facts = {"verdict": verdict.verdict, "reason": verdict.reason}
            yield _location("/integrity/verdict/location", fix, colour, facts, time_ns=verdict.time_ns)
        if verdict.verdict == "erroneous":
            text = f"fix {verdict.fix_id} is erroneous: {verdict.reason}"
            text += f": {verdict.detail}" if verdict.detail else ""
            yield log(verdict.time_ns, "integrity", text, warning=True)

    def _position(self, position: Position) -> Iterator[Drawing]:
        if position.usable != self._usable:
            self._usable = position.usable
            text = (
                "positions are usable" if position.usable else f"positions are not usable: {position.reason}"
            )
            yield log(position.time_ns, "integrity", text, warning=not position.usable)
        if position.latitude_rad is None or position.longitude_rad is None:
            return
        colour = _BLUE if position.usable else _AMBER
        facts = {"source": position.source, "reason": position.reason}
        yield _location("/integrity/position/location", position, colour, facts)
        track = self._track.geojson_at(position)
        if track is not None:
            yield Drawing("/integrity/position/track", "GeoJSON", encode("GeoJSON", {"geojson": track}))
        if self._frame is not None:
            height_m = self._height_m if position.height_m is None else position.height_m
            centre_m = self._frame.enu_from_geodetic(position.latitude_rad, position.longitude_rad, height_m)
            yield _levels(position, centre_m)

    def _pose(self, pose: Pose) -> Iterator[Drawing]:
        if pose.latitude_rad is None or pose.longitude_rad is None:
            return
        self._height_m = self._height_m if pose.road.elevation_m is None else pose.road.elevation_m
        place = (pose.latitude_rad, pose.longitude_rad, self._height_m)
        if self._frame is None:
            self._frame = LocalFrame(*place)
        values = {**_at(pose.time_ns, "antenna"), **_degrees(*place), "color": _GREY}
        if pose.yaw_rad is not None:
            values["heading"] = math.degrees(heading_from_yaw(pose.yaw_rad))
        yield Drawing("/localizer/pose/location", "LocationFix", encode("LocationFix", values))
        x_m, y_m, z_m = self._frame.enu_from_geodetic(*place)
        translation = {"x": x_m, "y": y_m, "z": z_m}
        rotation = _quaternion(pose.roll_rad or 0.0, pose.pitch_rad or 0.0, pose.yaw_rad or 0.0)
        in_frame = {
            **_at(pose.time_ns, "local"),
            "pose": {"position": translation, "orientation": rotation},
        }
        yield Drawing("/localizer/pose/in_local", "PoseInFrame", encode("PoseInFrame", in_frame))
        transform = {
            "timestamp": _timestamp(pose.time_ns),
            "parent_frame_id": "local",
            "child_frame_id": "vehicle",
        }
        transform |= {"translation": translation, "rotation": rotation}
        yield Drawing("/transforms", "FrameTransform", encode("FrameTransform", transform))


def log(time_ns: int, name: str, text: str, *, warning: bool) -> Drawing:
    """Return a line of the log of a service, at a GPS time."""
    values = {"timestamp": _timestamp(time_ns), "level": _WARNING if warning else _INFO, "message": text}
    return Drawing("/log", "Log", encode("Log", {**values, "name": name}))


class _Track:
    """The track of usable and other positions, thinned as it grows."""

    def __init__(self) -> None:
        self._points: list[tuple[float, float, bool]] = []
        self._step_m = _TRACK_STEP_M
        self._last_rad: tuple[float, float] | None = None
        self._drawn_ns = 0

    def geojson_at(self, position: Position) -> str | None:
        """Add a position; return the track now and then."""
        latitude_rad, longitude_rad = position.latitude_rad, position.longitude_rad
        assert latitude_rad is not None
        assert longitude_rad is not None
        here_rad = (latitude_rad, longitude_rad)
        if (
            self._last_rad is None
            or math.hypot(*east_north_between(*self._last_rad, *here_rad)) >= self._step_m
        ):
            self._last_rad = here_rad
            point = (round(math.degrees(longitude_rad), 7), round(math.degrees(latitude_rad), 7))
            self._points.append((*point, position.usable))
        if len(self._points) > _TRACK_POINTS:
            self._points, self._step_m = self._points[::2], 2.0 * self._step_m
        if position.time_ns - self._drawn_ns < _TRACK_EVERY_NS:
            return None
        self._drawn_ns = position.time_ns
        return json.dumps({"type": "FeatureCollection", "features": self._features()}, separators=(",", ":"))

    def _features(self) -> list[dict[str, Any]]:
        features: list[dict[str, Any]] = []
        for longitude_deg, latitude_deg, usable in self._points:
            point = [longitude_deg, latitude_deg]
            if features and features[-1]["properties"]["usable"] == usable:
                features[-1]["geometry"]["coordinates"].append(point)
                continue
            if features:
                features[-1]["geometry"]["coordinates"].append(point)
            style = {"color": "#1a66e6" if usable else "#ffb300", "weight": 3}
            features.append(
                {
                    "type": "Feature",
                    "properties": {"usable": usable, "style": style},
                    "geometry": {"type": "LineString", "coordinates": [point]},
                }
            )
        return [feature for feature in features if len(feature["geometry"]["coordinates"]) > 1]


def _location(
    topic: str,
    place: Fix | Position,
    colour: dict[str, float],
    facts: Mapping[str, str],
    *,
    time_ns: int | None = None,
) -> Drawing:
    assert place.latitude_rad is not None
    assert place.longitude_rad is not None
    values = {
        **_at(place.time_ns if time_ns is None else time_ns, "antenna"),
        **_degrees(place.latitude_rad, place.longitude_rad, place.height_m or 0.0),
        "color": colour,
        "metadata": [{"key": key, "value": value} for key, value in facts.items()],
    }
    if place.covariance_enu_m2 is not None:
        values |= {
            "position_covariance": _square(place.covariance_enu_m2),
            "position_covariance_type": _COVARIANCE_KNOWN,
        }
    return Drawing(topic, "LocationFix", encode("LocationFix", values))


def _levels(position: Position, centre_m: tuple[float, float, float]) -> Drawing:
    radii_m = {"alert limit": position.alert_limit_m}
    if position.horizontal_protection_level_m is not None:
        radii_m["protection level"] = position.horizontal_protection_level_m
    colours = {"alert limit": _GREY, "protection level": _GREEN if position.usable else _RED}
    pose = {"position": dict(zip("xyz", centre_m, strict=True)), "orientation": {"w": 1.0}}
    entities = [
        {
            **_at(position.time_ns, "local"),
            "id": name,
            "cylinders": [
                {
                    "pose": pose,
                    "size": {"x": 2.0 * radius_m, "y": 2.0 * radius_m, "z": _LEVEL_THICKNESS_M},
                    "bottom_scale": 1.0,
                    "top_scale": 1.0,
                    "color": {**colours[name], "a": 0.3},
                }
            ],
        }
        for name, radius_m in radii_m.items()
    ]
    return Drawing("/integrity/position/levels", "SceneUpdate", encode("SceneUpdate", {"entities": entities}))


def _at(time_ns: int, frame: str) -> dict[str, Any]:
    return {"timestamp": _timestamp(time_ns), "frame_id": frame}


def _timestamp(time_ns: int) -> dict[str, int]:
    seconds, nanos = divmod(unix_ns_from_gps_ns(time_ns), NS_PER_SECOND)
    return {"seconds": seconds, "nanos": nanos}


def _degrees(latitude_rad: float, longitude_rad: float, height_m: float) -> dict[str, float]:
    return {
        "latitude": math.degrees(latitude_rad),
        "longitude": math.degrees(longitude_rad),
        "altitude": height_m,
    }


def _square(upper: Sequence[float]) -> list[float]:
    ee, en, eu, nn, nu, uu = upper
    return [ee, en, eu, en, nn, nu, eu, nu, uu]


def _quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> dict[str, float]:
    """Quaternion of yaw, then pitch, then roll, as `geodesy.se3.rotation_from_roll_pitch_yaw`."""
    sr, cr = math.sin(0.5 * roll_rad), math.cos(0.5 * roll_rad)
    sp, cp = math.sin(0.5 * pitch_rad), math.cos(0.5 * pitch_rad)
    sy, cy = math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad)
    return {
        "x": sr * cp * cy - cr * sp * sy,
        "y": cr * sp * cy + sr * cp * sy,
        "z": cr * cp * sy - sr * sp * cy,
        "w": cr * cp * cy + sr * sp * sy,
    }
