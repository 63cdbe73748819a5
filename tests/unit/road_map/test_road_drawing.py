"""Roads as viewers draw them: lines in degrees, as many as a viewer can draw."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from camber.formats.foxglove.protobuf import decode
from camber.road_map.road_columns import RoadLinks
from camber.road_map.road_drawing import draw_roads


def links(count: int, points: int) -> RoadLinks:
    numbers = list(range(count))
    line = np.radians(np.column_stack((np.full(points, 35.0), 136.0 + np.arange(points) * 1e-4)))
    columns: dict[str, Any] = {"link_id": numbers[::-1], "start_node": numbers, "end_node": numbers}
    return RoadLinks(**columns, level=[0] * count, sigma_m=[0.1] * count, vertices=[line] * count)


def drawn(roads: RoadLinks) -> dict[str, Any]:
    topic, schema, data = draw_roads(roads)
    assert (topic, schema) == ("/map/roads", "GeoJSON")
    return json.loads(decode("GeoJSON", data)["geojson"])


def test_a_link_is_a_line_of_longitudes_and_latitudes() -> None:
    roads = drawn(links(2, 3))
    assert [feature["properties"]["link_id"] for feature in roads["features"]] == ["0", "1"]
    assert roads["features"][0]["geometry"]["coordinates"] == [
        [136.0, 35.0],
        [136.0001, 35.0],
        [136.0002, 35.0],
    ]
    assert roads["left_out"] == 0


@pytest.mark.parametrize("points", [2, 1000])
def test_of_a_large_map_the_rest_is_left_out_and_counted(points: int) -> None:
    count = 60_000 // points
    roads = drawn(links(count, points))
    assert len(roads["features"]) == 50_000 // points
    assert roads["left_out"] == count - len(roads["features"])
