"""The service publishes the height of the configured method, or that it is unknown."""

from __future__ import annotations

import math
from typing import Any, cast

import pytest
from pydantic import ValidationError

from camber.antenna_height.service import SERVICE, AntennaHeightService
from camber.antenna_height.settings import AntennaHeightSettings
from camber.runtime.bus import Bus
from camber.schemas.antenna import AntennaHeight
from camber.schemas.channels import BY_NAME, inputs_of
from camber.schemas.codec import encode
from camber.schemas.motion import Ranging, Suspension
from support.fake_bus import FakeBus

NS = 1_000_000_000
START_NS = 1_300_000_000 * NS
STROKE = {"way": "stroke", "suspension_to_antenna_m": 0.92, "tyre_radius_m": 0.31}


class HeightBus(FakeBus):
    def __init__(self) -> None:
        super().__init__()
        self.published: list[AntennaHeight] = []

    def publish(self, name: str, message: AntennaHeight) -> None:
        assert name == "antenna_height"
        encode(message)
        self.published.append(message)


class Running:
    """The service on a fake bus; times are seconds since the start."""

    def __init__(self, **settings: Any) -> None:
        self.bus = HeightBus()
        self.service = AntennaHeightService(AntennaHeightSettings(**settings), cast(Bus, self.bus))

    def stroke(self, at_s: float, height_m: float = 0.45, sigma_m: float = 0.01) -> None:
        time_ns = START_NS + round(at_s * NS)
        handler = self.service.handlers()["suspension"]
        handler(Suspension(time_ns=time_ns, stroke_height_m=height_m, stroke_sigma_m=sigma_m))

    def published(self, at_s: float) -> list[AntennaHeight]:
        """Advance to this time; return what is published."""
        before = len(self.bus.published)
        self.service.advance(START_NS + round(at_s * NS))
        return self.bus.published[before:]

    def height(self, at_s: float) -> AntennaHeight:
        (height,) = self.published(at_s)
        return height


def test_a_fixed_height_is_repeated_every_period() -> None:
    running = Running(fixed_height_m=1.8, fixed_sigma_m=0.02)
    height = running.height(0.0)
    assert (height.status, height.way, height.height_m, height.sigma_m) == ("known", "fixed", 1.8, 0.02)
    assert height.time_ns == START_NS
    assert running.published(0.1) == []
    assert running.height(0.2).time_ns == START_NS + NS // 5
    assert running.service.healthy()


def test_without_configuration_the_height_is_unknown() -> None:
    running = Running()
    height = running.height(0.0)
    assert (height.status, height.way, height.height_m, height.sigma_m) == ("unknown", None, None, None)
    assert height.reason == "fixed_height_m is not set"
    assert not running.service.healthy()


def test_a_stroke_height_that_is_too_old_is_no_height() -> None:
    limit_s = BY_NAME["suspension"].max_age_s
    assert limit_s is not None
    running = Running(**STROKE)
    running.stroke(0.0)
    assert running.height(limit_s).status == "known"
    stale = running.height(limit_s + 0.2)
    assert (stale.status, stale.height_m) == ("unknown", None)
    assert "stroke" in stale.reason
    assert not running.service.healthy()


def test_an_implausible_height_is_unknown_and_an_issue() -> None:
    running = Running(way="stroke", suspension_to_antenna_m=-5.0, tyre_radius_m=0.3)
    running.stroke(0.0)
    height = running.height(0.0)
    assert height.status == "unknown"
    assert "expected -1 m to 100 m" in height.reason
    assert sorted(code for code, _ in running.bus.issues) == ["height_unknown", "implausible_height"]


def test_a_clock_that_is_set_back_does_not_stop_the_publication() -> None:
    running = Running(fixed_height_m=1.8)
    assert len(running.published(3600.0)) == 1
    assert len(running.published(0.0)) == 1
    assert running.published(0.1) == []


def test_before_the_first_tick_nothing_is_published() -> None:
    running = Running(fixed_height_m=1.8)
    running.service.advance(0)
    assert running.bus.published == []
    assert not running.service.healthy()


def test_inputs_are_those_of_the_channel_table() -> None:
    assert SERVICE is AntennaHeightService
    assert set(Running().service.handlers()) == {channel.name for channel in inputs_of("antenna_height")}


PLACE = {"x_m": 0.0, "y_m": 0.0, "z_m": 1.5}


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"way": "stroke", "tyre_radius_m": 0.3}, "way stroke needs suspension_to_antenna_m and tyre_radius_m"),
        ({"way": "stroke", "suspension_to_antenna_m": 0.3}, "needs suspension_to_antenna_m and tyre_radius_m"),
        ({"way": "ranging", "ranging": PLACE}, "way ranging needs antenna and ranging or lidar"),
        ({"way": "ranging", "antenna": PLACE}, "way ranging needs antenna and ranging or lidar"),
        ({"way": "scan_matching", "antenna": PLACE, "ranging": PLACE}, "needs antenna and lidar"),
        ({"way": "automatic", "lidar": PLACE}, "way automatic needs antenna and ranging or lidar"),
        ({"antenna": {"x_m": 0.0, "z_m": 1.5}}, "antenna.y_m"),
        ({"flat_slope_return": 0.2}, "flat_slope_return is above flat_slope_leave"),
        ({"flat_uneven_return_m": 0.2}, "flat_uneven_return_m is above flat_uneven_leave_m"),
    ],
)  # fmt: skip
def test_a_method_without_its_sensors_is_refused_by_the_settings(
    settings: dict[str, Any], expected: str
) -> None:
    with pytest.raises(ValidationError) as refused:
        AntennaHeightSettings(**settings)
    assert expected in str(refused.value).replace("\n", ".")


def test_each_measurement_of_the_configured_method_publishes_and_no_other() -> None:
    running = Running(**STROKE | {"way": "ranging", "antenna": PLACE, "ranging": PLACE | {"z_m": 0.9}})
    distance = Ranging(time_ns=START_NS, distance_m=0.9, beam_angle_rad=math.pi / 2, distance_sigma_m=0.004)
    running.service.handlers()["ranging"](distance)
    height = running.height(0.0)
    assert (height.status, height.way, height.height_m) == ("known", "ranging", pytest.approx(1.5))
    running.stroke(0.05, 0.27)
    assert running.published(0.05) == []
    running.service.handlers()["ranging"](distance.model_copy(update={"time_ns": START_NS + NS // 10}))
    assert [other.way for other in running.height(0.1).others] == ["stroke"]
