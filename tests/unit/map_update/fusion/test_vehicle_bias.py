"""Vehicle biases: from other streets, shrunk to what is known, and never explaining a changed road away."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.map_update.fusion.robust_surface_heights import VoteColumns, estimate_heights
from camber.map_update.fusion.vehicle_bias import Biases, VarianceComponents, estimate_biases

Floats = NDArray[np.float64]


@dataclass
class District:
    """Votes as a fleet casts them over streets of ten surfaces each, in the order of surfaces and voters."""

    surface: NDArray[np.int64]
    voter: NDArray[np.int64]
    session: NDArray[np.int64]
    value_m: Floats
    sigma_m: Floats

    def fused(self) -> tuple[Biases, Floats]:
        """Biases in this order, and the heights of the surfaces."""
        order = np.lexsort((self.session, self.voter, self.surface))
        surfaces, begins = np.unique(self.surface[order], return_index=True)
        begins = np.append(begins, len(order))
        columns = {name: getattr(self, name)[order] for name in ("voter", "session", "value_m", "sigma_m")}
        block = surfaces[np.repeat(np.arange(len(surfaces)), np.diff(begins))] // 10
        biases = estimate_biases(begins, block=block, shape_m2=np.zeros(len(surfaces)), **columns)
        columns |= {"value_m": columns["value_m"] - biases.bias_m, "weight": biases.weight}
        votes = VoteColumns(**{name: columns[name] for name in VoteColumns._fields})
        heights = estimate_heights(begins, votes, known=biases.known, vote_sigma_m=biases.components.vote_m)
        back = np.argsort(order)
        in_order = {
            name: getattr(biases, name)[back] for name in ("bias_m", "variance_m2", "weight", "known")
        }
        return replace(biases, **in_order), heights.location_m


def district(seed: int, vehicles: int = 60, streets: int = 6, sessions: int = 3) -> tuple[District, Floats]:
    """Everyone drives everywhere; with the true bias (n,) of each vote."""
    rng = np.random.default_rng(seed)
    v, g, s = (x.ravel() for x in np.mgrid[:vehicles, :sessions, : 10 * streets])
    bias_m = rng.normal(0.0, 0.02, vehicles)[v] + rng.normal(0.0, 0.015, (vehicles, sessions))[v, g]
    value_m = bias_m + rng.normal(0.0, 0.014, len(v))
    return District(s, v, g, value_m, np.full(len(v), 0.02)), bias_m


def rms(x: Floats) -> float:
    return float(np.sqrt(np.mean(x**2)))


def test_biases_and_variance_components_are_estimated() -> None:
    made, true_m = district(1)
    result, heights_m = made.fused()
    # All but what the vehicles have in common, which nobody can know: 2 cm over √60, 2.6 mm.
    error_m = result.bias_m - true_m
    assert rms(error_m - error_m.mean()) < 0.003
    assert abs(error_m.mean()) < 0.008
    assert rms(heights_m - heights_m.mean()) < 0.0025
    assert result.components == pytest.approx(VarianceComponents(0.014, 0.015, 0.02), rel=0.25)
    assert result.known.all()


def test_the_stated_variance_is_that_of_the_error() -> None:
    squares = []
    for seed in range(10):
        made, true_m = district(seed, streets=2, sessions=2)
        result, _ = made.fused()
        error_m = result.bias_m - true_m
        squares.append(np.mean((error_m - error_m.mean()) ** 2) / np.mean(result.variance_m2))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize(("off_m", "moved_m"), [(0.2, 0.001), (0.06, 0.002)])
def test_a_vehicle_20_cm_off_gets_no_weight_and_one_6_cm_off_is_corrected(
    off_m: float, moved_m: float
) -> None:
    made, _ = district(2)
    _, before_m = made.fused()
    made.value_m[made.voter == 7] += off_m
    result, after_m = made.fused()
    assert np.abs(after_m - before_m).max() < moved_m
    if off_m == 0.2:
        assert result.weight[made.voter == 7].max() < 0.01
    else:
        assert result.bias_m[made.voter == 7].mean() > 0.03


def test_a_changed_street_is_not_attributed_to_its_vehicles() -> None:
    """Forty vehicles drive on one street only, which is 10 cm higher; twenty drive everywhere."""
    made, _ = district(3)
    only = made.voter >= 20
    keep = ~only | (made.surface < 10)
    made = District(*(getattr(made, field.name)[keep] for field in fields(made)))
    made.value_m[made.surface < 10] += 0.1
    result, heights_m = made.fused()
    assert heights_m[:10] == pytest.approx(np.full(10, 0.1), abs=0.02)
    only = made.voter >= 20
    assert not result.known[only].any()
    assert (result.bias_m[only] == 0.0).all()
    assert result.variance_m2[only] == pytest.approx(0.02**2 + 0.015**2, rel=0.5)
    assert result.known[~only].all()


def test_false_heights_on_one_street_are_not_subtracted_as_bias() -> None:
    made, _ = district(4)
    honest, _ = made.fused()
    there = (made.voter < 12) & (made.surface < 10)
    made.value_m[there] += 0.08
    lied, heights_m = made.fused()
    assert lied.bias_m[there] == pytest.approx(honest.bias_m[there], abs=0.005)
    assert np.abs(heights_m[:10] - heights_m[10:].mean()).max() < 0.012


def test_a_session_of_wrong_fixes_affects_neither_its_vehicle_nor_the_street() -> None:
    made, _ = district(5)
    honest, before_m = made.fused()
    wrong = (made.voter == 3) & (made.session == 1)
    made.value_m[wrong] += 0.9
    result, after_m = made.fused()
    others = (made.voter == 3) & (made.session != 1)
    assert result.bias_m[others] == pytest.approx(honest.bias_m[others], abs=0.004)
    assert result.weight[wrong].max() == 0.0
    assert np.abs(after_m - before_m).max() < 0.001


def test_a_small_stated_sigma_gains_no_weight_and_a_large_one_loses() -> None:
    made, _ = district(6)
    plain, _ = made.fused()
    made.sigma_m[made.voter == 1] = 0.001
    made.sigma_m[made.voter == 2] = 0.3
    result, _ = made.fused()
    assert result.weight[made.voter == 1] == pytest.approx(plain.weight[made.voter == 1], rel=0.01)
    assert result.weight[made.voter == 2].max() < 0.02


def test_two_vehicles_hardly_move_the_prior() -> None:
    made, _ = district(7, vehicles=2, streets=2, sessions=1)
    result, _ = made.fused()
    assert result.components == pytest.approx(VarianceComponents(0.014, 0.015, 0.02), rel=0.5)
