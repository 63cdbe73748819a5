"""A fault acts from its onset to its end; one that could not act, or too many together, are refused."""

from __future__ import annotations

import re

import numpy as np
import pytest

from camber.simulator.faults.schedule import Jamming, WrongBase, of_kind
from camber.simulator.scenario import ScenarioError, load_scenario


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
    ("overrides", "fault", "message"),
    [
        ([], 'kind="blocked_lidar", share=0.5', "blocked_lidar cannot act, expected a table lidar"),
        (['vehicle="robot"'], 'kind="changed_load", load_kg=1.0', "changed_load cannot act, expected vehicle = 'car'"),
        (["fleet.vehicles=2"], 'kind="missing_epochs"', "missing_epochs cannot act, expected no table fleet"),
        ([], 'kind="dropped_process", end_s=2.0, service="gnss"', "started again at once, expected no end_s"),
    ],
)  # fmt: skip
def test_a_fault_that_could_not_act_is_refused(overrides: list[str], fault: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(message)):
        load_scenario("open-sky", [*overrides, f"faults=[{{onset_s=1.0, {fault}}}]"])


def tyre(onset_s: float, end_s: float, change_m: float) -> str:
    return f'{{kind="changed_tyre", onset_s={onset_s}, end_s={end_s}, radius_change_m={change_m}}}'


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        ([tyre(1, 9, -0.08), tyre(5, 20, -0.08)], "2 changed_tyre act at 5 s with radius_change_m -0.16"),
        ([tyre(1, 9, -0.1), tyre(1, 20, 0.1), tyre(8, 20, 0.1)], "2 changed_tyre act at 9 s"),
        (
            ['{kind="wheel_slip", onset_s=1, factor=0.2}', '{kind="wheel_slip", onset_s=2, factor=0.7}'],
            "2 wheel_slip act at 2 s with factor -0.1 together, expected 0 to 3",
        ),
        (
            [f'{{kind="changed_load", onset_s={s}, load_kg=800.0}}' for s in (1, 2, 3)],
            "3 changed_load act at 3 s with load_kg 2400 together, expected 0 to 2000",
        ),
    ],
)
def test_faults_that_act_at_once_keep_the_limits_of_one(faults: list[str], message: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(message)) as refused:
        load_scenario("open-sky", [f"faults=[{', '.join(faults)}]"])
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("vehicle", ["car", "robot"])
def test_faults_that_follow_or_undo_one_another_are_taken(vehicle: str) -> None:
    faults = [tyre(1, 5, -0.1), tyre(5, 20, -0.1), tyre(6, 7, 0.1)]
    scenario = load_scenario("open-sky", [f'vehicle="{vehicle}"', f"faults=[{', '.join(faults)}]"])
    assert len(scenario.faults) == 3
