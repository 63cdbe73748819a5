"""What viewers draw of a drive: fixes by their verdict, positions with their levels, poses, the track, the log."""

from __future__ import annotations

import json
import math
from random import Random
from typing import Any

import numpy as np
import pytest

from camber.formats.drive.viewer_messages import ViewerMessages
from camber.formats.foxglove.drawings import Drawings
from camber.formats.foxglove.protobuf import decode
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import encode
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Position, Verdict
from camber.schemas.pose import Pose, Road
from support.messages import build

T = 1_400_000_000 * 10**9
LATITUDE, LONGITUDE = math.radians(35.0), math.radians(136.0)
FIX = Fix(
    time_ns=T, fix_id=7, origin="receiver", quality="fixed", latitude_rad=LATITUDE, longitude_rad=LONGITUDE,
    height_m=50.0, covariance_enu_m2=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
)  # fmt: skip
POSITION = Position(
    time_ns=T, source="rtk", usable=True, latitude_rad=LATITUDE, longitude_rad=LONGITUDE, height_m=50.0,
    horizontal_protection_level_m=1.25, alert_limit_m=1.5,
)  # fmt: skip
POSE = Pose(
    time_ns=T, mode="anchored", provenance="given", latitude_rad=LATITUDE, longitude_rad=LONGITUDE, yaw_rad=0.0,
    road=Road(status="known", elevation_m=48.0),
)  # fmt: skip


def drawn(drawings: Drawings, *messages: Message) -> dict[str, list[dict[str, Any]]]:
    by_topic: dict[str, list[dict[str, Any]]] = {}
    for message in messages:
        for topic, schema, data in drawings.of(message):
            by_topic.setdefault(topic, []).append(decode(schema, data))
    return by_topic


def test_a_fix_stands_where_it_claims_to_be_at_its_utc() -> None:
    (fix,) = drawn(Drawings(), FIX)["/gnss/fix/location"]
    assert fix["timestamp"]["seconds"] * 10**9 == unix_ns_from_gps_ns(T)
    assert (fix["latitude"], fix["longitude"], fix["altitude"]) == pytest.approx((35.0, 136.0, 50.0))
    assert fix["position_covariance"] == [1.0, 2.0, 3.0, 2.0, 4.0, 5.0, 3.0, 5.0, 6.0]


def test_an_erroneous_fix_is_red_and_in_the_log_with_its_reason() -> None:
    wrong = Verdict(time_ns=T, fix_id=7, verdict="erroneous", reason="height_disagrees", detail="1.2 m")
    right = Verdict(time_ns=T, fix_id=7, verdict="confirmed", reason="height_agrees")
    of = drawn(Drawings(), FIX, wrong, right)
    red, green = (fix["color"] for fix in of["/integrity/verdict/location"])
    assert red["r"] > 2.0 * red["g"]
    assert green["g"] > 2.0 * green["r"]
    (line,) = of["/log"]
    assert (line["name"], line["message"]) == ("integrity", "fix 7 is erroneous: height_disagrees: 1.2 m")


def test_a_verdict_without_its_fix_has_no_place() -> None:
    verdict = Verdict(time_ns=T, fix_id=8, verdict="confirmed", reason="height_agrees")
    assert drawn(Drawings(), FIX, verdict).keys() == {"/gnss/fix/location"}


def test_levels_are_discs_to_scale_at_the_position() -> None:
    of = drawn(Drawings(), POSE, POSITION)
    entities = {entity["id"]: entity for entity in of["/integrity/position/levels"][0]["entities"]}
    sizes = {name: entity["cylinders"][0]["size"]["x"] for name, entity in entities.items()}
    assert sizes == {"alert limit": 3.0, "protection level": 2.5}
    centre = entities["alert limit"]["cylinders"][0]["pose"]["position"]
    assert (centre.get("x", 0.0), centre.get("y", 0.0), centre["z"]) == pytest.approx(
        (0.0, 0.0, 2.0), abs=1e-6
    )


def test_the_log_says_when_positions_become_usable_or_not() -> None:
    lost = POSITION.model_copy(update={"usable": False, "reason": "pose_missing"})
    lines = drawn(Drawings(), POSITION, POSITION, lost, lost, POSITION)["/log"]
    texts = [line["message"] for line in lines]
    assert texts == ["positions are usable", "positions are not usable: pose_missing", "positions are usable"]


@pytest.mark.parametrize("seed", range(20))
def test_a_pose_s_quaternion_is_its_rotation(seed: int) -> None:
    random = Random(seed)
    roll, pitch, yaw = random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(-3.0, 3.0)
    pose = POSE.model_copy(update={"roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw})
    (in_local,) = drawn(Drawings(), pose)["/localizer/pose/in_local"]
    x, y, z, w = (in_local["pose"]["orientation"][name] for name in "xyzw")
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    assert np.allclose(rotation, rotation_from_roll_pitch_yaw(roll, pitch, yaw))


def test_the_track_stays_small_and_says_where_positions_were_usable() -> None:
    drawings = Drawings()
    tracks = []
    for n in range(6000):  # 100 minutes at 1 Hz, 60 km
        place = {"longitude_rad": LONGITUDE + n * 2e-6, "time_ns": T + n * 10**9, "usable": n % 2000 < 1000}
        tracks += drawn(drawings, POSITION.model_copy(update=place)).get("/integrity/position/track", [])
    assert len(tracks) == 600
    last = json.loads(tracks[-1]["geojson"])
    assert [feature["properties"]["usable"] for feature in last["features"]] == [True, False] * 3
    assert len(tracks[-1]["geojson"]) < 25_000


@pytest.mark.parametrize("name", ["fix", "verdict", "position", "pose"])
def test_any_valid_message_is_given_to_viewers(name: str) -> None:
    messages, channel = ViewerMessages(), BY_NAME[name]
    for seed in range(100):
        payload = encode(build(channel.message, Random(seed)), source="gnss", sequence=seed)
        first, *drawings = messages.of(name, channel.key_for("car"), payload)
        assert first.channel.topic == channel.key.replace("camber/v1/{vehicle}", "")
        for drawing in drawings:
            decode(drawing.channel.schema.removeprefix("foxglove."), drawing.data)


def test_only_one_vehicle_is_drawn() -> None:
    messages, payload = ViewerMessages(), encode(FIX, source="gnss")
    counts = [
        len(list(messages.of("fix", f"camber/v1/{name}/gnss/fix", payload))) for name in ("a", "b", "a")
    ]
    assert counts == [2, 1, 2]


def test_what_is_no_fix_is_given_to_viewers_and_not_drawn() -> None:
    payload = encode(FIX, source="gnss").replace(b"receiver", b"nonsense")
    (only,) = ViewerMessages().of("fix", "camber/v1/car/gnss/fix", payload)
    assert json.loads(only.data)["origin"] == "nonsense"
