"""`drive.toml` of an imported bag: what was there, and as comments what is guessed, missing and not taken."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from itertools import pairwise

from camber.formats.receiver.solution import SolutionQuality
from camber.formats.ros.sensor_messages import NAV_SAT_FIX
from camber.geodesy.se3 import roll_pitch_yaw_from_rotation
from camber.tools.bags.drive_import import IMU, MOTION, POSITIONS, SWEEPS, DriveParts, TopicTally
from camber.tools.bags.raw_bytes import RawFile

_LATEST_S = 1.0  # chosen: no driver takes longer from measurement to message; clocks differ by whole seconds
_MISSING = """\
# missing: the map, a folder that `camber map build` makes or that you were given, relative to this one
# [map]
# release = "map"

# missing: the antenna's height above the road at rest; without it no fix is confirmed
# z_m of [lever_arms.antenna] does not replace it; sigma_m contains the motion of the springs while driving
# [antenna_height]
# height_m = 1.80
# sigma_m = 0.02
"""
_NO_START = "\n# missing: a start, since no position is a fix: [initial_pose]\n"


def imported_manifest(name: str, bags: Sequence[str], parts: DriveParts) -> str:
    """Return the text of drive.toml."""
    sections = [
        [
            f"# From {', '.join(bags)} by camber import {version('camber')}. Check what is marked guess and missing.",
            f"name = {json.dumps(name)}",
            'datum = "WGS84"  # guess: ROS messages do not contain the realisation',
        ],
        _receiver(parts.tally(parts.topics.receiver)),
        _observations(parts.raw.files),
        _motion(parts.tally(parts.topics.odometry)),
        _imu(parts.tally(parts.topics.imu), parts),
        _sweeps(parts.tally(parts.topics.lidar), parts),
        _clocks([tally for tally in parts.tallies.values() if tally.delays_ns]),
        *_lever_arms(parts),
        _not_taken(parts),
    ]
    texts = ("\n".join(map(_printable, lines)) for lines in sections if lines)
    receiver = parts.tally(parts.topics.receiver)
    has_fixes = receiver is not None and receiver.qualities[SolutionQuality.FIX] > 0
    return "\n\n".join(texts) + "\n\n" + _MISSING + ("" if has_fixes else _NO_START)


def _printable(line: str) -> str:
    """Return a line that names and faults of a bag cannot make two of."""
    return "".join(character if character.isprintable() else " " for character in line)


def _about(tally: TopicTally) -> list[str]:
    text = f"# {tally.topic.name} ({tally.topic.kind}): {tally.taken} of {tally.topic.messages} messages, "
    lines = [f"{text}recorded {tally.delay_s:.3f} s after their stamps (median)"]
    if tally.first_fault is not None:
        lines.append(f"# left out: {tally.left_out}, the first: {tally.first_fault}")
    return lines


def _receiver(tally: TopicTally | None) -> list[str]:
    if tally is None:
        return ["# missing: positions of a receiver"]
    lines = [*_about(tally), "# " + ", ".join(f"{q.name} {n}" for q, n in sorted(tally.qualities.items()))]
    if tally.topic.kind == NAV_SAT_FIX:
        lines.append(
            "# missing: whether integers are resolved. NavSatFix does not contain it: no position is a fix"
        )
    else:
        lines.append("# guess: altitude is above the ellipsoid; GPSFix leaves its reference open")
    return [*lines, "[receiver]", 'format = "pos"', f'file = "{POSITIONS}"']


def _observations(files: Sequence[RawFile]) -> list[str]:
    lines = [
        f"# {file.topic}: {file.name}, {file.frames} frames, {file.measurements} of them with measurements"
        for file in files
    ]
    rovers = [file for file in files if file.protocol == "ubx" and file.measurements and file.subframes]
    bases = [file for file in files if file.protocol == "rtcm" and file.measurements]
    if len(rovers) == 1 and len(bases) == 1:
        lines += [
            f"# guess: {rovers[0].name} is of the vehicle, {bases[0].name} of the base station",
            "[observations]",
            f'rover_obs = "{rovers[0].name}"',
            f'base_obs = "{bases[0].name}"',
            f'ephemerides = ["{rovers[0].name}"]',
        ]
    elif files:
        lines.append(
            "# missing for [observations]: one UBX with RXM-RAWX and RXM-SFRBX and one RTCM 3 with MSM"
        )
    return lines


def _motion(tally: TopicTally | None) -> list[str]:
    if tally is None:
        return ["# missing: wheel speed and yaw rate"]
    guess = (
        "# guess: it is of wheels and a gyroscope. If satellites, LiDAR or a filter are in it, leave it out"
    )
    return [*_about(tally), guess, "[motion]", f'file = "{MOTION}"']


def _imu(tally: TopicTally | None, parts: DriveParts) -> list[str]:
    if tally is None:
        return ["# missing: an inertial measurement unit"]
    lines = [*_about(tally), "# guess: its class; mems or tactical, if it is as accurate as those"]
    base_from_unit = parts.base_from(tally.frame_id)
    table = ["[imu]", f'file = "{IMU}"', 'class = "phone"']
    if base_from_unit is None:
        lines.append(f"# missing: where {tally.frame_id!r} is; guess: its axes are the vehicle's")
        return [*lines, *table]
    places = zip("xyz", base_from_unit[:3, 3].tolist(), strict=True)
    turns = zip(("roll", "pitch", "yaw"), roll_pitch_yaw_from_rotation(base_from_unit[:3, :3]), strict=True)
    table += [f"{axis}_m = {place_m:.6g}" for axis, place_m in places]
    return [*lines, *table, *(f"{name}_deg = {math.degrees(angle):.6g}" for name, angle in turns)]


def _sweeps(tally: TopicTally | None, parts: DriveParts) -> list[str]:
    if tally is None or tally.layout is None:
        return ["# missing: sweeps of a LiDAR"]
    lines, layout = _about(tally), tally.layout
    if layout.time is None:
        lines.append(f"# missing: times of points ({layout.no_time}): sweeps are not de-skewed")
        lines.append("# guess: the stamp is that of the sweep's end")
    else:
        lines.append(f"# times of points: field {layout.time.name} ({layout.time.makers})")
    if parts.base_from(tally.frame_id) is None:
        lines.append(f"# guess: axes of {tally.frame_id!r} are the vehicle's")
    elif tally.turned:
        lines.append(f"# turned from {tally.frame_id!r} into the axes of {parts.base_frame!r}")
    return [*lines, "[sweeps]", f'folder = "{SWEEPS}"']


def _clocks(tallies: Sequence[TopicTally]) -> list[str]:
    """Of topics whose stamps are of clocks that differ: by GPS − UTC, TAI − UTC, or hours."""
    by_delay = sorted(tallies, key=lambda tally: tally.delay_s)
    return [
        f"# wrong: stamps of {before.topic.name} are {after.delay_s - before.delay_s:.1f} s ahead of those of "
        f"{after.topic.name}, by the times of recording"
        for before, after in pairwise(by_delay)
        if after.delay_s - before.delay_s > _LATEST_S
    ]


def _lever_arms(parts: DriveParts) -> Iterator[list[str]]:
    topics = parts.topics
    yield [f"# guess: {parts.base_frame!r} is on the road, below the middle of the rear axle"]
    arms = {"antenna": topics.receiver, "lidar": topics.lidar, "wheel": topics.odometry}
    for arm, topic in arms.items():
        tally = parts.tally(topic)
        if tally is None:
            continue
        matrix = parts.base_from(tally.frame_id)
        if matrix is None:
            yield [f"# missing: [lever_arms.{arm}]; no transform from {tally.frame_id!r} in /tf_static"]
            continue
        places = (
            f"{axis}_m = {place:.6g}" for axis, place in zip("xyz", matrix[:3, 3].tolist(), strict=True)
        )
        yield [f"[lever_arms.{arm}]  # {tally.frame_id!r}", *places]


def _not_taken(parts: DriveParts) -> list[str]:
    return [f"# not taken: {topic.name} ({topic.kind}, {topic.messages})" for topic in parts.topics.rest]
