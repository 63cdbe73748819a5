"""A warning is reported when it happens and when it happens again, with what an operator can do about it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.engine_warnings import HELP, EngineWarnings
from camber.gnss.position.rtk_engine import Engine
from camber.gnss.warm_up import _constellation


def test_a_warning_is_reported_each_time_it_has_happened_again() -> None:
    engine, warnings = Engine(EngineSettings()), EngineWarnings()
    assert warnings.new(engine) == []
    engine.warnings["base_silent"] += 3
    engine.warnings["rover_clock_step"] += 1
    assert warnings.new(engine) == [
        ("base_silent", f"3 epochs; {HELP['base_silent']}"),
        ("rover_clock_step", f"1 epochs; {HELP['rover_clock_step']}"),
    ]
    assert warnings.new(engine) == []
    engine.warnings["base_silent"] += 1
    assert warnings.new(engine) == [("base_silent", f"4 epochs; {HELP['base_silent']}")]


def test_refused_ephemerides_are_reported_with_the_reason() -> None:
    engine, warnings = Engine(EngineSettings()), EngineWarnings()
    first, second, third = _constellation()[:3]
    for ephemeris in (
        replace(first, sqrt_a=1.0),
        replace(second, sqrt_a=np.inf),
        replace(third, eccentricity=0.7),
    ):
        engine.add_ephemeris(ephemeris)
    assert warnings.new(engine) == [("ephemeris_refused", "not_finite 1, orbit 2")]
    assert warnings.new(engine) == []


def test_a_base_far_from_its_coordinate_is_reported_with_the_distance() -> None:
    engine, warnings = Engine(EngineSettings()), EngineWarnings()
    engine.warnings["base_position_wrong"] += 1
    assert warnings.new(engine) == [("base_position_wrong", "1 epochs; not a position on the earth")]
    engine.warnings["base_position_wrong"] += 1
    engine.base.miss_m = 117.4
    assert warnings.new(engine) == [("base_position_wrong", "2 epochs; its single point is 117 m away")]
