"""Changes of the map as the page is shown them: of all workers together, or why there are none."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from camber.live.health_watch import changes_as_json
from camber.runtime.bus import QueryFailed
from camber.schemas.fleet import HELD_REASONS, HeldChanges, MapChanges, PublishedChanges, RegionAlarms

START_NS = 1_400_000_000 * 1_000_000_000
LARGEST_ID = 2**62


def answer(**more: Any) -> MapChanges:
    f4, i4, f8 = np.float32, np.int32, np.float64
    place = {"latitude_rad": np.array([0.5], f8), "longitude_rad": np.array([1.0], f8)}
    held = HeldChanges(
        surface_id=np.array([LARGEST_ID]), link_id=np.array([LARGEST_ID - 1]),
        in_map_m=np.array([0.01], f4), offset_m=np.array([0.08], f4),
        standard_error_m=np.array([0.005], f4), agreement=np.array([0.5], f4), vehicles=np.array([7], i4),
        votes=np.array([21], i4), days=np.array([3], i4),
        reason=np.array([HELD_REASONS.index("disagreed")], np.uint8), **place,
    )  # fmt: skip
    published = PublishedChanges(
        surface_id=np.array([4]), link_id=np.array([3]), offset_m=np.array([-0.05], f4), sigma_m=np.array([0.01], f4),
        vehicles=np.array([9], i4), since_map_version=np.array([8]), **place,
    )  # fmt: skip
    alarms = RegionAlarms(
        everywhere=np.array([0], np.uint8), shift_m=np.array([0.06], f4), share=np.array([0.75], f4),
        surfaces=np.array([40], i4), **place,
    )  # fmt: skip
    fields = {"status": "known", "map_version": 8, "held": held, "published": published, "alarms": alarms}
    fields["pending"] = held
    return MapChanges(time_ns=START_NS, **fields | {"left_out": 3} | more)


def test_each_change_has_its_place_and_its_numbers() -> None:
    shown = json.loads(json.dumps(changes_as_json([answer()], {3: "Elm Street"})))
    assert (shown["problem"], shown["left_out"]) == ("", 3)
    (held,), (published,), (alarm,) = shown["held"], shown["published"], shown["alarms"]
    assert (held["surface_id"], held["reason"], held["votes"], held["days"]) == (
        str(LARGEST_ID),
        "disagreed",
        21,
        3,
    )
    assert held["link_id"] == str(LARGEST_ID - 1)
    assert shown["pending"] == [held]
    assert (held["road"], published["road"]) == (f"link {LARGEST_ID - 1}", "Elm Street")
    assert (held["lat"], held["lon"]) == pytest.approx((math.degrees(0.5), math.degrees(1.0)))
    assert (held["offset_m"], held["in_map_m"]) == pytest.approx((0.08, 0.01))
    assert published["sigma_m"] == pytest.approx(0.01)
    assert (alarm["everywhere"], alarm["surfaces"]) == (0, 40)


def test_workers_add_up_and_one_that_knows_nothing_changes_nothing() -> None:
    unknown = MapChanges(time_ns=START_NS, status="unknown", reason="nothing has been fused yet")
    shown = changes_as_json([answer(), unknown, answer(), QueryFailed("timeout")], {})
    assert (len(shown["held"]), shown["left_out"], shown["problem"]) == (2, 6, "")


def test_without_an_answer_the_reason_is_shown() -> None:
    unknown = MapChanges(time_ns=START_NS, status="unknown", reason="nothing has been fused yet")
    assert changes_as_json([unknown], {})["problem"] == "nothing has been fused yet"
    absent = changes_as_json([QueryFailed("absent", "map_update of fleet is not on the bus")], {})
    assert absent["problem"] == "absent: map_update of fleet is not on the bus"
    assert [absent[name] for name in ("held", "pending", "published", "alarms")] == [[], [], [], []]
