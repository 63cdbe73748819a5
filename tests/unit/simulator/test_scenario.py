"""A scenario is one file; what is wrong with it or its faults is one line; what comes with Camber can be used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camber.simulator.injected_faults import Jamming, WrongBase, of_kind
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


def together(*faults: str) -> str:
    return f"faults=[{', '.join(faults)}]"


def tyre(onset_s: float, end_s: float, change_m: float) -> str:
    return f'{{kind="changed_tyre", onset_s={onset_s}, end_s={end_s}, radius_change_m={change_m}}}'


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("place.kind=town", "place.kind is 'town': should be 'open-sky', 'city', 'canyon', 'canyons', 'overpass' or"),
        ("imu.class=gyro", "imu.class is 'gyro': should be 'phone', 'mems' or 'tactical'"),
        ("imu.rate_hz=1000", "imu.rate_hz is '1000'"),
        ("place.colour=1", "place.colour is not known; expected one of kind, latitude_deg"),
        ("start=2026-03-20T01:30:00Z", "expected a date and time of GPS time, without a zone"),
        ("satellites.rate_hz=3", "satellites.rate_hz is '3'"),
        ('faults=[{kind="quake", onset_s=1.0}]', "faults.0"),
        ('faults=[{kind="jamming", onset_s=1.0}]', "faults.0.jamming.loss_db is missing"),
        ('faults=[{kind="wrong_base", onset_s=1.0, east=3.0}]', "did you mean east_m?"),
        ('faults=[{kind="wrong_base", onset_s=9.0, end_s=9.0}]', "end_s is not after onset_s"),
        ('faults=[{kind="wrong_base", onset_s=120.0}]', "faults.0: onset_s is 120.0, expected one before the end"),
        ('faults=[{kind="dropped_process", onset_s=1.0, end_s=2.0, service="gnss"}]',
         "started again at once, expected no end_s"),
        # Faults that act at once keep the limits of one.
        (together(tyre(1, 9, -0.08), tyre(5, 20, -0.08)), "2 changed_tyre act at 5 s with radius_change_m -0.16"),
        (together(tyre(1, 9, -0.1), tyre(1, 20, 0.1), tyre(8, 20, 0.1)), "2 changed_tyre act at 9 s"),
        (together('{kind="wheel_slip", onset_s=1, factor=0.2}', '{kind="wheel_slip", onset_s=2, factor=0.7}'),
         "2 wheel_slip act at 2 s with factor -0.1 together, expected 0 to 3"),
        (together(*(f'{{kind="changed_load", onset_s={s}, load_kg=800.0}}' for s in (1, 2, 3))),
         "3 changed_load act at 3 s with load_kg 2400 together, expected 0 to 2000"),
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


def test_a_fault_acts_from_its_onset_until_before_its_end() -> None:
    time_s = np.array([0.9, 1.0, 1.9, 2.0])
    jamming = Jamming(kind="jamming", onset_s=1.0, end_s=2.0, loss_db=3.0)
    assert jamming.acts(time_s).tolist() == [False, True, True, False]
    assert WrongBase(kind="wrong_base", onset_s=1.0).acts(time_s).tolist() == [False, True, True, True]


def test_faults_are_chosen_by_their_kind() -> None:
    faults = load_scenario("faults").faults
    (base,) = of_kind(faults, WrongBase)
    assert base.east_m == 12.0


@pytest.mark.parametrize(
    ("override", "fault", "message"),
    [
        ("seed=1", 'kind="blocked_lidar", share=0.5', "blocked_lidar cannot act, expected a table lidar"),
        ('vehicle="robot"', 'kind="changed_load", load_kg=1.0', "changed_load cannot act, expected vehicle = 'car'"),
        ("motion=false", 'kind="wheel_slip", factor=1.2', "wheel_slip cannot act, expected motion = true"),
        ("fleet.vehicles=2", 'kind="missing_epochs"', "missing_epochs cannot act, expected no table fleet"),
    ],
)  # fmt: skip
def test_a_fault_that_could_not_act_is_refused(override: str, fault: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        load_scenario("open-sky", [override, f"faults=[{{onset_s=1.0, {fault}}}]"])


def test_packets_of_a_lidar_need_the_motion_on_their_can_bus() -> None:
    with pytest.raises(ScenarioError, match=r"lidar\.packets is set, expected motion = true"):
        load_scenario("open-sky", ["motion=false", "lidar.packets=ouster"])


def test_an_inertial_unit_is_none_unless_it_is_asked_for() -> None:
    assert load_scenario("open-sky").imu is None
    imu = load_scenario("open-sky", ["imu={}"]).imu
    assert imu is not None
    assert (imu.imu_class, imu.rate_hz) == ("mems", 200.0)


@pytest.mark.parametrize("vehicle", ["car", "robot"])
def test_faults_that_follow_or_undo_one_another_are_taken(vehicle: str) -> None:
    faults = together(tyre(1, 5, -0.1), tyre(5, 20, -0.1), tyre(6, 7, 0.1))
    scenario = load_scenario("open-sky", [f'vehicle="{vehicle}"', faults])
    assert len(scenario.faults) == 3
