"""What receiver and base say reaches the engine in the right order; the vehicle's motion reaches the heading alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import Ephemeris, ObservationEpoch
from camber.gnss.observations.receiver_streams import StationPosition, StreamReader
from camber.gnss.observations.rover import Rover, SolvedEpoch
from camber.gnss.position.engine_settings import EngineSettings
from camber.schemas.motion import Motion
from support.raw_drive import RawDrive

NS = 1_000_000_000


class Sky:
    """All messages of the drive, by epoch."""

    def __init__(self, drive: RawDrive) -> None:
        near_ns = drive.times_ns[0]
        rover, base = (
            StreamReader(name, kind, "here", near_ns) for name, kind in (("rover", "ubx"), ("base", "rtcm"))
        )  # type: ignore[arg-type]
        self.rover = [epoch_in(rover.feed(part)) for part in drive.ubx_parts]
        decoded = [base.feed(part) for part in drive.rtcm_parts]
        self.base = [epoch_in(items) for items in decoded]
        self.ephemerides = [what for _, what in decoded[0] if isinstance(what, Ephemeris)]
        (self.station,) = [what for _, what in decoded[0] if isinstance(what, StationPosition)]


def epoch_in(items: Any) -> ObservationEpoch:
    (epoch,) = [what for _, what in items if isinstance(what, ObservationEpoch)]
    return epoch


@pytest.fixture(scope="module")
def sky(raw_drive: RawDrive) -> Sky:
    return Sky(raw_drive)


def ready(sky: Sky, base_ecef_m: Any = None) -> Rover:
    """With ephemerides, and the base's position as its stream says it."""
    rover = Rover(EngineSettings(), base_ecef_m)
    for ephemeris in sky.ephemerides:
        rover.receive("ephemerides", ephemeris)
    rover.receive("base", sky.station)
    return rover


def solved(rover: Rover) -> list[SolvedEpoch]:
    return [rover.solve(epoch) for epoch in rover.take_pending()]


def first_of(rover: Rover, sky: Sky) -> SolvedEpoch:
    """The first epoch with the base's."""
    rover.receive("base", sky.base[0])
    rover.receive("rover", sky.rover[0])
    (first,) = solved(rover)
    return first


def test_epochs_are_solved_in_the_order_in_which_they_came(sky: Sky) -> None:
    rover = ready(sky)
    for epoch in sky.rover[:3]:
        rover.receive("rover", epoch)
    assert [each.epoch for each in solved(rover)] == sky.rover[:3]
    assert solved(rover) == []


def test_observations_on_the_stream_of_ephemerides_are_nobodys(sky: Sky) -> None:
    rover = ready(sky)
    rover.receive("ephemerides", sky.rover[0])
    assert solved(rover) == []
    assert rover.engine.base.epoch is None


def test_only_a_base_that_has_no_given_position_is_where_its_stream_says(sky: Sky) -> None:
    given = (-3.0e6, 4.0e6, 3.5e6)
    rover = ready(sky, given)
    assert rover.engine.base.position_ecef_m == pytest.approx(given)
    rover = ready(sky)
    assert rover.engine.base.position_ecef_m == pytest.approx(sky.station.position_ecef_m)
    rover.receive("rover", StationPosition(position_ecef_m=given))
    rover.receive("ephemerides", StationPosition(position_ecef_m=given))
    assert rover.engine.base.position_ecef_m == pytest.approx(sky.station.position_ecef_m)


def test_a_fix_names_the_base_that_it_rests_on_and_a_position_by_itself_none(sky: Sky) -> None:
    rover = ready(sky)
    rover.receive("rover", sky.rover[0])
    (alone,) = solved(rover)
    assert (alone.solution.quality, alone.base_station) == ("single", None)
    rover.receive("base", sky.base[0])
    rover.receive("rover", sky.rover[1])
    (first,) = solved(rover)
    x, y, z = sky.station.position_ecef_m
    assert first.solution.quality == "fixed"
    assert first.base_station == f"{sky.station.label}@{x:.3f}:{y:.3f}:{z:.3f}"


def test_another_number_or_another_coordinate_is_another_base(sky: Sky) -> None:
    x, y, z = sky.station.position_ecef_m
    for label, up_m in (("rtcm-2", 0.0), ("rtcm-1", 0.05)):
        rover = ready(sky)
        rover.receive("base", StationPosition(position_ecef_m=(x, y, z + up_m), label=label))
        assert first_of(rover, sky).base_station == f"{label}@{x:.3f}:{y:.3f}:{z + up_m:.3f}"
    assert first_of(ready(sky, (x, y, z)), sky).base_station == f"given@{x:.3f}:{y:.3f}:{z:.3f}"


def test_the_ionosphere_of_gps_is_taken_and_beidous_is_not(sky: Sky) -> None:
    rover = ready(sky)
    alpha, beta = (1e-8, 2e-8, 3e-8, 4e-8), (1e5, 2e5, 3e5, 4e5)
    rover.receive("rover", IonosphereCoefficients(system="C", alpha=alpha, beta=beta))
    assert rover.engine.ionosphere.size == 0
    rover.receive("rover", IonosphereCoefficients(system="G", alpha=alpha, beta=beta))
    assert rover.engine.ionosphere.tolist() == [*alpha, *beta]


def drive(
    rover: Rover, sky: Sky, wheel: float | None, *, age_ns: int = 0, yaw: float = 0.0
) -> list[SolvedEpoch]:
    results = []
    for k in range(8):
        at_ns = sky.rover[k].time_ns - age_ns
        rover.receive_motion(Motion(time_ns=at_ns, wheel_speed_m_s=wheel, yaw_rate_rad_s=yaw))
        rover.receive("base", sky.base[k])
        rover.receive("rover", sky.rover[k])
        results += solved(rover)
    return results


def test_motion_changes_no_position_and_no_velocity(sky: Sky) -> None:
    quiet, turning = drive(ready(sky), sky, None), drive(ready(sky), sky, 20.0, yaw=1.0)
    for one, other in zip((e.solution for e in quiet), (e.solution for e in turning), strict=True):
        assert one.position_ecef_m is not None
        assert one.velocity is not None
        assert other.velocity is not None
        np.testing.assert_array_equal(one.position_ecef_m, other.position_ecef_m)
        np.testing.assert_array_equal(one.velocity.velocity_enu_m_s, other.velocity.velocity_enu_m_s)


class Velocities:
    """In place of the heading filter: what it is given."""

    def __init__(self) -> None:
        self.given: list[tuple[Any, ...]] = []
        self.rates: list[float] = []

    def add_velocity(self, *values: Any) -> None:
        self.given.append(values)

    def add_yaw_rate(self, time_ns: int, yaw_rate_rad_s: float) -> None:
        self.rates.append(yaw_rate_rad_s)

    def at(self, time_ns: int) -> None:
        return None


@pytest.mark.parametrize(
    ("wheel", "age_ns", "taken"), [(3.0, 0, 8), (3.0, NS // 2, 8), (3.0, NS // 2 + 1, 0), (None, 0, 0)]
)
def test_a_velocity_turns_the_heading_only_with_a_wheel_speed_of_its_time(
    wheel: float | None, age_ns: int, taken: int, sky: Sky
) -> None:
    rover, decoded = ready(sky), Velocities()
    rover._heading = decoded  # type: ignore[assignment]
    results = drive(rover, sky, wheel, age_ns=age_ns, yaw=0.25)
    assert decoded.rates == [0.25] * 8
    assert len(decoded.given) == taken
    for (velocity, speed), result in zip(decoded.given, results, strict=False):
        assert velocity is result.solution.velocity
        assert speed == wheel
