"""The layout for Foxglove and Lichtblick shows topics and fields that there are."""

from __future__ import annotations

import json
from typing import Any

from camber.formats.drive.message_json import json_schema
from camber.formats.drive.recording import topic_of
from camber.formats.foxglove import drawings
from camber.road_map.road_drawing import TOPIC
from camber.schemas.channels import CHANNELS
from support.tree import ROOT

LAYOUT = json.loads((ROOT / "deploy/foxglove/camber.json").read_text("utf-8"))
CLASSES = {topic_of(channel, channel.key_for("car")): channel.message for channel in CHANNELS}
DRAWN = {part for part in (drawings.__doc__ or "").split() if part.startswith("/")} | {
    TOPIC,
    "/vehicle/sweep",
}


def values(part: Any) -> list[str]:
    """All paths."""
    if isinstance(part, dict):
        here = [part["value"]] if isinstance(part.get("value"), str) else []
        return here + [value for inner in part.values() for value in values(inner)]
    return [value for inner in part for value in values(inner)] if isinstance(part, list) else []


def panels(part: Any) -> list[str]:
    return (
        [part]
        if isinstance(part, str)
        else [name for side in ("first", "second") for name in panels(part[side])]
    )


def test_every_path_is_a_field_of_a_message() -> None:
    paths = values(LAYOUT["configById"])
    assert len(paths) > 8
    for path in paths:
        topic, _, field = path.partition(".")
        assert field in json_schema(CLASSES[topic])["properties"], path


def test_every_topic_is_drawn() -> None:
    config = LAYOUT["configById"]
    topics = {config["map!camber"]["followTopic"], *config["map!camber"]["disabledTopics"]}
    topics |= {
        *config["map!camber"]["topicColors"],
        *config["3D!camber"]["topics"],
        config["RosOut!camber"]["topicToRender"],
    }
    assert topics <= DRAWN


def test_every_panel_has_its_settings() -> None:
    assert sorted(panels(LAYOUT["layout"])) == sorted(LAYOUT["configById"])
