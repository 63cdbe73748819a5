"""The fleet: the newest of each vehicle, and what is left out."""

from __future__ import annotations

import math
from typing import Any

import pytest

from camber.live import fleet
from camber.live.fleet import FleetSource
from camber.runtime.raw_subscription import RawSample
from camber.schemas.base import Message
from camber.schemas.codec import encode
from camber.schemas.integrity import Position, Verdict
from support.running import client_of

START_NS = 1_400_000_000 * 1_000_000_000


def sample(vehicle: str, message: Message | bytes, channel: str = "position") -> RawSample:
    data = message if isinstance(message, bytes) else encode(message, source="integrity")
    return RawSample(channel, f"camber/v1/{vehicle}/integrity/{channel}", data, 0)


def position(k: int = 0, **more: Any) -> Position:
    fields = {"source": "rtk", "usable": True, "alert_limit_m": 1.5, "latitude_rad": math.radians(35.0)}
    return Position(time_ns=START_NS + k * 10**8, **fields | {"longitude_rad": math.radians(137.0)} | more)


@pytest.fixture
def source() -> FleetSource:
    return FleetSource(client_of("tcp/127.0.0.1:1"))


def test_the_newest_of_each_vehicle_is_kept(source: FleetSource) -> None:
    verdict = Verdict(time_ns=START_NS, fix_id=1, verdict="erroneous", reason="height_disagrees")
    source.take([sample("b", position(0)), sample("a", position(0)), sample("a", verdict, "verdict")])
    source.take([sample("a", position(1, usable=False, reason="no_independent_position"))])
    first, second = source.vehicles()
    assert (first["vehicle"], second["vehicle"]) == ("a", "b")
    assert (first["usable"], first["why"], first["verdict"]) == (
        False,
        "no_independent_position",
        "erroneous",
    )
    assert first["lat"] == pytest.approx(35.0)
    assert first["t"] - second["t"] == pytest.approx(0.1)
    assert source.number == 2


def test_a_vehicle_without_a_position_has_no_place(source: FleetSource) -> None:
    source.take([sample("a", position(0, latitude_rad=None, longitude_rad=None, source="none"))])
    assert source.vehicles()[0]["lat"] is None


def test_damage_floods_and_invented_names_are_counted(
    source: FleetSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fleet, "_MOST_VEHICLES", 3)
    monkeypatch.setattr(source, "most_messages", 10)
    source.take([sample("a", b"damaged"), sample("x" * 70, position())])
    source.take([sample(f"v{k}", position(k)) for k in range(20)])
    assert source.left_out() == {"flood": 10, "undecodable": 1, "vehicles": 1 + 7}
    assert [row["vehicle"] for row in source.vehicles()] == ["v10", "v11", "v12"]
    assert source.number == 2
