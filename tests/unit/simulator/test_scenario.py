"""A scenario is one file; what is wrong with it is one line; what comes with Camber can be used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camber.simulator.scenario import ScenarioError, load_scenario, shipped
from camber.simulator.simulated_drive import district_of
from camber.simulator.world.district import make_district


def test_the_scenarios_that_the_readme_names_come_with_camber() -> None:
    names = "canyon canyons changed-road city faults fleet open-sky overpass tunnel-950s"
    assert shipped() == tuple(names.split())


@pytest.mark.parametrize("name", shipped())
def test_each_can_be_loaded_and_is_called_as_its_file(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.description


def test_every_kind_of_fault_is_in_the_scenario_of_faults_once_and_they_do_not_overlap() -> None:
    faults = load_scenario("faults").faults
    assert len({fault.kind for fault in faults}) == len(faults) == 14
    ends = [fault.end_s if fault.end_s is not None else np.inf for fault in faults]
    assert all(end < after.onset_s for end, after in zip(ends, faults[1:], strict=False))


def test_any_file_is_read_and_values_can_be_overridden(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\nstart = 2026-01-02T03:04:05\n[place]\nkind = "canyon"\n')
    scenario = load_scenario(str(path), ["seed=7", "place.heading_deg=12.5", "lidar.beams=32"])
    assert (scenario.name, scenario.seed, scenario.place.heading_deg) == ("mine", 7, 12.5)
    assert scenario.lidar is not None
    # 2026-01-02 is day 5 of GPS week 2399.
    assert scenario.start_ns == ((2399 * 7 + 5) * 86_400 + 3 * 3600 + 4 * 60 + 5) * 10**9


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("place.kind=town", "place.kind is 'town': should be 'open-sky', 'city', 'canyon', 'canyons', 'overpass' or"),
        ("place.colour=1", "place.colour is not known; expected one of kind, latitude_deg"),
        ("start=2026-03-20T01:30:00Z", "expected a date and time of GPS time, without a zone"),
        ("satellites.rate_hz=3", "satellites.rate_hz is '3'"),
        ('faults=[{kind="quake", onset_s=1.0}]', "faults.0"),
        ('faults=[{kind="jamming", onset_s=1.0}]', "faults.0.jamming.loss_db is missing"),
        ('faults=[{kind="wrong_base", onset_s=1.0, east=3.0}]', "did you mean east_m?"),
        ('faults=[{kind="wrong_base", onset_s=9.0, end_s=9.0}]', "end_s is not after onset_s"),
        ('faults=[{kind="wrong_base", onset_s=120.0}]', "faults.0: onset_s is 120.0, expected one before the end"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line_that_names_it(override: str, message: str) -> None:
    with pytest.raises(ScenarioError) as refused:
        load_scenario("city", [override])
    line = str(refused.value)
    assert message in line
    assert "city.toml" in line
    assert "\n" not in line


def test_for_a_scenario_that_does_not_exist_the_error_names_those_that_do() -> None:
    expected = "expected a scenario file or one of canyon, canyons, changed-road, city"
    with pytest.raises(ScenarioError, match=expected):
        load_scenario("nowhere")


@pytest.mark.parametrize(("name", "mean_m_s"), [("faults", 10.0), ("canyons", 8.0)])
def test_a_long_scenario_drives_to_its_end(name: str, mean_m_s: float) -> None:
    """At the mean speed of its streets, and with the stops."""
    scenario = load_scenario(name, [])
    district = make_district(scenario.place.kind, scenario.seed, changed_roads={})
    path = district.path(scenario.place.route)
    assert len(path.east_m) * path.step_m / mean_m_s + path.stop_s.sum() >= scenario.duration_s


def test_rounds_are_the_citys() -> None:
    with pytest.raises(ScenarioError, match="only a city has rounds"):
        load_scenario("canyon", ['place.route="rounds"'])


def test_drives_of_other_seeds_see_the_same_place_where_the_place_has_a_seed() -> None:
    def heights_of(seed: int, *more: str) -> bytes:
        district = district_of(load_scenario("city", [f"seed={seed}", *more]))
        return district.path("default").up_m.tobytes()

    assert heights_of(1, "place.seed=5") == heights_of(2, "place.seed=5") == heights_of(5)
    assert heights_of(1) != heights_of(2)
