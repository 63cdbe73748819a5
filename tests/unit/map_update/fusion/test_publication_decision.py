"""What is published, withdrawn, held and why; regions that moved alike; what is known of heights afterwards."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from camber.map_update.fusion.publication_decision import (
    DECISIONS,
    REASONS,
    Decisions,
    PublicationSettings,
    benjamini_hochberg,
    decide,
    normal_deviates,
    upper_tails,
)
from camber.map_update.fusion.robust_surface_heights import FusedHeights
from camber.map_update.fusion.surface_neighbours import SurfaceNeighbourhood, build_neighbourhood
from support.small_map import surface, surfaces

SETTINGS = PublicationSettings()
LEAST_SIGMA_M = 0.01


def street(count: int = 12, link: int = 1, first: int = 100, north_m: float = 0.0) -> list[dict[str, object]]:
    """Surfaces of 20 m one after another to the east."""
    return [surface(first + k, 20.0 * k, north_m, link_id=link) for k in range(count)]


STREET = build_neighbourhood(surfaces(street()), street_m=300.0, region_m=5000.0)


def heights(
    offset_m: float | list[float] | np.ndarray, n: int | None = None, **changes: float
) -> FusedHeights:
    """Of surfaces that thirty known vehicles have seen on ten days, all agreeing, to 2 mm; but for what is changed."""
    offsets = np.broadcast_to(np.asarray(offset_m, float), (n or np.size(offset_m),)).copy()
    few_m = changes.pop("few_m", 0.004)
    sessions = {"days": 10, "first_session": 100, "last_session": 120}
    counts = {"voters": 30, "known_voters": 30, "votes": 40, **sessions}
    values = {"standard_error_m": 0.002, "degrees": 40.0, "agreement": 0.95, **counts, **changes}
    columns = {name: np.full(len(offsets), value) for name, value in values.items()}
    return FusedHeights(
        location_m=offsets, without_highest_m=offsets - few_m, without_lowest_m=offsets + few_m, **columns
    )


def decision(
    fused: FusedHeights,
    correction_m: float | list[float] = 0.0,
    around: SurfaceNeighbourhood = STREET,
    settings: PublicationSettings = SETTINGS,
    common_m: float = 0.001,
    shape_m: float = 0.005,
) -> Decisions:
    n = len(fused.location_m)
    corrections = np.broadcast_to(np.asarray(correction_m, float), (n,)).copy()
    return decide(
        np.arange(n),
        fused,
        common_error_m=np.full(n, common_m),
        shape_m=np.full(n, shape_m),
        correction_m=corrections,
        neighbourhood=around,
        settings=settings,
    )


def outcomes(decisions: Decisions) -> list[tuple[str, str]]:
    return [(DECISIONS[d], REASONS[r]) for d, r in decisions.surfaces[["decision", "reason"]].tolist()]


def test_a_change_of_a_street_is_published_with_its_number_and_sigma() -> None:
    decisions = decision(heights(0.08, 12))
    assert outcomes(decisions) == [("publish", "changed")] * 12
    rows = decisions.of("publish")
    assert rows["surface_id"].tolist() == list(range(100, 112))
    assert rows["correction_m"] == pytest.approx(0.08)
    assert rows["sigma_m"] == pytest.approx(LEAST_SIGMA_M)
    assert len(decisions.alarms) == 0


@pytest.mark.parametrize(
    ("offset_m", "changes", "expected"),
    [
        (0.08, {"voters": 4}, ("nothing", "too_few_vehicles")),
        (0.08, {"voters": 0}, ("nothing", "too_few_vehicles")),
        (0.08, {"days": 1}, ("nothing", "too_few_days")),
        (0.029, {}, ("nothing", "within_threshold")),
        (-0.029, {}, ("nothing", "within_threshold")),
        (0.037, {"few_m": 0.0}, ("nothing", "not_significant")),
        (0.08, {"standard_error_m": 0.02}, ("nothing", "not_significant")),
        (0.08, {"few_m": 0.048}, ("nothing", "rests_on_few")),
        (-0.08, {"few_m": np.nan}, ("nothing", "rests_on_few")),
        (0.08, {"known_voters": 4}, ("hold", "vehicles_not_known")),
        (0.08, {"agreement": 0.6}, ("hold", "disagreed")),
        (0.6, {}, ("hold", "too_large")),
        (np.nan, {"voters": 0}, ("nothing", "too_few_vehicles")),
    ],
)
def test_a_change_that_is_not_published_has_a_reason(
    offset_m: float, changes: dict[str, float], expected: tuple[str, str]
) -> None:
    decisions = decision(heights(offset_m, 12, **changes))
    assert outcomes(decisions) == [expected] * 12
    assert (decisions.surfaces["correction_m"] == 0.0).all()


def test_what_all_vehicles_have_in_common_counts_as_error() -> None:
    assert outcomes(decision(heights(0.05, 12), common_m=0.001))[0] == ("publish", "changed")
    assert outcomes(decision(heights(0.05, 12), common_m=0.01))[0] == ("nothing", "not_significant")


def test_a_step_that_no_neighbour_shares_is_held() -> None:
    offset_m = np.zeros(12)
    offset_m[5] = 0.08
    assert outcomes(decision(heights(offset_m)))[5] == ("hold", "step")
    offset_m[6] = 0.05
    assert outcomes(decision(heights(offset_m)))[5:7] == [("publish", "changed")] * 2
    # More than it is no contradiction, less than half is one.
    offset_m[5:7] = (0.05, 0.2)
    assert outcomes(decision(heights(offset_m)))[5] == ("publish", "changed")


def test_neighbours_with_few_or_uncertain_votes_do_not_contradict() -> None:
    offset_m = np.zeros(12)
    offset_m[5] = 0.08
    fused = heights(offset_m)
    few = fused.voters.copy()
    few[[4, 6]] = 3
    assert outcomes(decision(fused._replace(voters=few)))[5] == ("publish", "changed")
    vague = fused.standard_error_m.copy()
    vague[4] = 0.03
    assert outcomes(decision(fused._replace(standard_error_m=vague)))[5] == ("publish", "changed")


def test_a_neighbour_that_was_corrected_before_shares_the_change() -> None:
    offset_m, correction_m = np.zeros(12), [0.0] * 12
    offset_m[5:7] = correction_m[6] = 0.08
    expected = [("publish", "changed"), ("nothing", "within_threshold")]
    assert outcomes(decision(heights(offset_m), correction_m))[5:7] == expected


def test_a_correction_stays_is_renewed_or_is_withdrawn() -> None:
    assert outcomes(decision(heights(0.09, 12), 0.08)) == [("nothing", "within_threshold")] * 12
    assert (decision(heights(0.09, 12), 0.08).surfaces["correction_m"] == 0.08).all()
    renewed = decision(heights(0.16, 12), 0.08)
    assert outcomes(renewed) == [("publish", "changed")] * 12
    assert renewed.surfaces["correction_m"] == pytest.approx(0.16)
    withdrawn = decision(heights(0.01, 12), 0.08)
    assert outcomes(withdrawn) == [("withdraw", "changed_back")] * 12
    assert (withdrawn.surfaces["correction_m"] == 0.0).all()
    assert withdrawn.surfaces["sigma_m"] == pytest.approx(np.hypot(0.01, 0.0055), rel=0.01)


def test_a_confirmed_height_gets_its_sigma_and_no_other() -> None:
    sigma_m = decision(heights(0.004, 12)).surfaces["sigma_m"]
    assert sigma_m == pytest.approx(LEAST_SIGMA_M)
    assert decision(heights(0.02, 12)).surfaces["sigma_m"] == pytest.approx(np.hypot(0.02, 0.0055), rel=0.01)
    assert decision(heights(0.0, 12), shape_m=0.05).surfaces["sigma_m"] == pytest.approx(0.05, rel=0.01)
    for few in ({"known_voters": 19}, {"agreement": 0.5}, {"days": 1}):
        assert np.isnan(decision(heights(0.0, 12, **few)).surfaces["sigma_m"]).all()


def region(links: int) -> SurfaceNeighbourhood:
    rows = [row for k in range(links) for row in street(8, k + 1, 1000 * (k + 1), 40.0 * k)]
    return build_neighbourhood(surfaces(rows), street_m=300.0, region_m=5000.0)


@pytest.mark.parametrize("shift_m", [0.05, -0.05])
def test_a_region_that_moved_alike_raises_an_alarm_and_is_held(shift_m: float) -> None:
    rng = np.random.default_rng(1)
    around = region(8)
    decisions = decision(heights(shift_m + rng.normal(0.0, 0.01, 64)), around=around)
    assert len(decisions.of("publish")) == 0
    assert len(decisions.of("hold")) > 40
    assert {reason for kind, reason in outcomes(decisions) if kind == "hold"} == {"regional_shift"}
    assert {-1} < set(decisions.alarms["region"].tolist())
    assert decisions.alarms["shift_m"] == pytest.approx(shift_m, abs=0.004)
    assert decisions.alarms["surfaces"].tolist()[-1] == 64
    assert np.isnan(decisions.surfaces["sigma_m"]).all()


def test_a_few_changed_roads_of_a_region_are_no_shift_of_it() -> None:
    around = region(8)
    offset_m = np.random.default_rng(1).normal(0.0, 0.01, 64)
    offset_m[:24] += 0.08
    decisions = decision(heights(offset_m), around=around)
    assert len(decisions.alarms) == 0
    assert len(decisions.of("publish")) == 24


def test_one_road_is_no_region() -> None:
    assert len(decision(heights(0.08, 24), around=region(3)).alarms) == 0


def test_false_discoveries_among_many_at_the_threshold_are_few() -> None:
    """Ten thousand surfaces exactly 3 cm off: some are beyond 3.3 standard errors, hardly any is let through."""
    rng = np.random.default_rng(3)
    n = 10_000
    z = rng.normal(0.0, 1.0, n)
    discovered = benjamini_hochberg(upper_tails(z), 0.01, n)
    assert (z > 3.3).sum() > 0
    assert discovered.sum() <= 1
    z[:500] += 8.0
    discovered = benjamini_hochberg(upper_tails(z), 0.01, n)
    assert discovered[:500].all()
    assert discovered[500:].sum() <= 0.03 * 500


def test_benjamini_hochberg_is_that_of_scipy() -> None:
    p = np.random.default_rng(4).uniform(0.0, 1.0, 200) ** 3
    expected = stats.false_discovery_control(p) <= 0.05
    assert (benjamini_hochberg(p, 0.05, 200) == expected).all()
    assert not benjamini_hochberg(np.array([0.5]), 0.01, 1).any()
    assert len(benjamini_hochberg(np.zeros(0), 0.01, 0)) == 0


@pytest.mark.parametrize("degrees", [10.0, 15.0, 40.0, 200.0])
def test_normal_deviates_have_the_tails_of_students_t(degrees: float) -> None:
    t = np.array([-5.0, -1.0, 0.0, 0.5, 2.0, 3.3, 6.0])
    p = upper_tails(normal_deviates(t, np.full(len(t), degrees)))
    assert np.log(p) == pytest.approx(np.log(stats.t.sf(t, degrees)), abs=0.05)


def test_a_larger_change_is_never_less_likely_published_or_held() -> None:
    """Of one surface, all else equal: once published, or held, so for every larger change up to the largest."""
    order = {"nothing": 0, "hold": 1, "publish": 1}
    sizes = np.linspace(0.0, 0.49, 50)
    seen = [order[outcomes(decision(heights(float(size), 12)))[0][0]] for size in sizes]
    assert seen == sorted(seen)
    assert seen[-1] == 1


def test_thresholds_are_settings() -> None:
    strict = PublicationSettings(publish_threshold_m=0.1, publish_vehicles=40)
    assert outcomes(decision(heights(0.08, 12), settings=strict))[0] == ("nothing", "too_few_vehicles")
