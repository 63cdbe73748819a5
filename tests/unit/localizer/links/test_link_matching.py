"""The current link by topology and history: roads that cross, run alongside, fork and end; and the link's line."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.links.link_matching import LinkLine, LinkMatcher, LinkNetwork, RoadLink
from support.pose_inputs import line_through


def a_link(link_id, nodes, *vertices, **more):
    start, end = nodes
    vertices_m = np.array(vertices, dtype=float)
    return RoadLink(link_id=link_id, start_node=start, end_node=end, vertices_m=vertices_m, **more)


ROAD = LinkNetwork([a_link("road", ("a", "b"), (0, 0), (400, 0))])


def covariance(sigma_m=1.0, yaw_deg=2.0):
    return np.diag([sigma_m**2, sigma_m**2, math.radians(yaw_deg) ** 2])


def drive(matcher, points, p=None, travelled=0.0, step=5.0):
    """Drive along points; the matches at every step."""
    p = covariance() if p is None else p
    matches = []
    for a, b in itertools.pairwise(points):
        a, b = np.array(a, dtype=float), np.array(b, dtype=float)
        length = float(np.hypot(*(b - a)))
        yaw = math.atan2(b[1] - a[1], b[0] - a[0])
        for k in range(1, round(length / step) + 1):
            at = a + (b - a) * (k * step / length)
            travelled += step
            matches.append(matcher.step((float(at[0]), float(at[1]), yaw), p, travelled_m=travelled))
    return matches


CROSS = [
    a_link("west", ("a", "b"), (-200, 0), (0, 0)),
    a_link("east", ("b", "c"), (0, 0), (200, 0)),
    a_link("over", ("s", "n"), (50, -200), (50, 200), level=1),
    a_link("north", ("b", "d"), (0, 0), (0, 200)),
]


def test_an_overpass_that_crosses_is_never_the_link():
    matches = drive(LinkMatcher(LinkNetwork(CROSS)), [(-150, 1), (150, 1)])
    assert all(match.status == "matched" for match in matches)
    assert [match.link_id for match in matches[:25]] == ["west"] * 25
    assert {match.link_id for match in matches[32:]} == {"east"}
    assert {match.level for match in matches} == {0}


def test_a_vehicle_on_the_overpass_stays_on_its_level():
    matches = drive(LinkMatcher(LinkNetwork(CROSS)), [(50, -150), (50, 150)], covariance(8.0))
    assert {match.link_id for match in matches} == {"over"}
    assert {match.level for match in matches} == {1}


def test_a_turn_at_a_junction_is_followed():
    matches = drive(LinkMatcher(LinkNetwork(CROSS)), [(-150, 0), (0, 0), (0, 150)])
    assert (matches[-1].status, matches[-1].link_id) == ("matched", "north")
    assert matches[-1].line.alpha_rad == pytest.approx(math.pi / 2)


STACKED = [
    a_link("ground", ("g0", "g1"), (0, 0), (1000, 0)),
    a_link("viaduct", ("v0", "v1"), (0, 3), (1000, 3), level=1),
]


def test_one_road_above_another_is_ambiguous_with_its_candidates():
    for match in drive(LinkMatcher(LinkNetwork(STACKED)), [(100, 1.5), (600, 1.5)]):
        assert match.status == "ambiguous"
        assert set(match.candidates) == {"ground", "viaduct"}
        assert match.level is None


def test_a_vehicle_that_came_up_the_ramp_is_on_the_upper_level():
    network = LinkNetwork(
        [
            a_link("approach", ("a", "f"), (-300, 0), (0, 0)),
            a_link("ground", ("f", "g"), (0, 0), (60, 0), (1000, 0)),
            a_link("ramp", ("f", "r"), (0, 0), (60, 25), (150, 40), level=0),
            a_link("viaduct", ("r", "v"), (150, 40), (220, 2), (1000, 2), level=1),
        ]
    )
    matches = drive(LinkMatcher(network), [(-200, 0), (0, 0), (60, 25), (150, 40), (220, 2), (900, 2)])
    assert (matches[-1].status, matches[-1].link_id, matches[-1].level) == ("matched", "viaduct", 1)
    below = drive(LinkMatcher(network), [(-200, 0), (0, 0), (900, 0)])
    assert (below[-1].status, below[-1].link_id, below[-1].level) == ("matched", "ground", 0)


def test_parallel_roads_beyond_the_uncertainty_are_distinguished():
    network = LinkNetwork(
        [
            a_link("here", ("a", "b"), (0, 0), (500, 0), sigma_m=1.0),
            a_link("there", ("c", "d"), (0, 40), (500, 40), sigma_m=1.0),
        ]
    )
    assert drive(LinkMatcher(network), [(50, 1), (300, 1)])[-1].status == "matched"
    lost = drive(LinkMatcher(network), [(50, 20), (300, 20)], covariance(15.0))
    assert lost[0].status == "ambiguous"


def test_a_fork_is_ambiguous_until_the_branches_part():
    network = LinkNetwork(
        [
            a_link("stem", ("a", "f"), (-200, 0), (0, 0)),
            a_link("left", ("f", "l"), (0, 0), (300, 60), level=1),
            a_link("right", ("f", "r"), (0, 0), (300, -60)),
        ]
    )
    matches = drive(LinkMatcher(network), [(-150, 0), (0, 0), (290, 58)])
    shortly_after = matches[33]
    assert shortly_after.status == "ambiguous"
    assert {"left", "right"} <= set(shortly_after.candidates)
    assert (matches[-1].status, matches[-1].link_id) == ("matched", "left")


def test_a_u_turn_changes_the_direction_of_travel():
    matches = drive(LinkMatcher(ROAD), [(50, -2), (200, -2), (205, 4), (50, 4)])
    assert matches[10].forward
    assert matches[-1].status == "matched"
    assert not matches[-1].forward
    assert abs(matches[-1].line.alpha_rad) == pytest.approx(math.pi)


def test_a_link_of_one_direction_is_not_followed_backwards():
    network = LinkNetwork([a_link("road", ("a", "b"), (0, 0), (400, 0), forward_only=True)])
    assert {m.status for m in drive(LinkMatcher(network), [(300, 0), (100, 0)])} == {"none"}


def test_a_car_park_has_no_link_and_the_road_is_matched_again_by_following_it():
    network = LinkNetwork([a_link("road", ("a", "b"), (0, 0), (600, 0))])
    matcher = LinkMatcher(network)
    matches = drive(matcher, [(0, 0), (200, 0), (200, 80), (260, 80), (260, 0)])
    assert matches[30].status == "matched"
    assert matches[52].status == "none"
    back = drive(matcher, [(260, 0), (400, 0)], travelled=5.0 * len(matches))
    assert back[0].status != "matched"
    assert back[-1].status == "matched"


def test_the_pose_with_an_unknown_heading_gets_no_line():
    match = LinkMatcher(ROAD).step((100.0, 0.0, 1.0), np.diag([1.0, 1.0, math.pi**2]), travelled_m=0.0)
    assert match.link_id == "road"
    assert match.line is None


def test_a_pose_too_uncertain_to_search_around_has_no_link():
    assert LinkMatcher(ROAD).step((100.0, 0.0, 0.0), covariance(60.0), travelled_m=0.0).status == "none"


def test_standing_still_adds_no_evidence():
    matcher = LinkMatcher(LinkNetwork(STACKED))
    first = matcher.step((100.0, 1.2, 0.0), covariance(), travelled_m=0.0)
    for _ in range(1000):
        assert matcher.step((100.0, 1.2, 0.0), covariance(), travelled_m=0.0) == first


def test_sharp_vertices_and_dead_ends_are_reported_by_their_distance():
    network = LinkNetwork(
        [
            a_link("bent", ("a", "b"), (0, 0), (100, 0), (100, 100)),
            a_link("on", ("b", "c"), (100, 100), (100, 300)),
        ]
    )
    assert network.to_sharp_m(0, 70.0) == pytest.approx(30.0)
    assert network.to_sharp_m(0, 190.0) == pytest.approx(90.0)
    assert network.to_sharp_m(1, 10.0) == pytest.approx(190.0)


def test_the_line_is_that_of_the_nearest_piece():
    network = LinkNetwork([a_link("road", ("a", "b"), (0, 0), (100, 0), (200, 20))])
    match = drive(LinkMatcher(network), [(10, 1), (90, 1), (190, 19)])[-1]
    expected = line_through((100.0, 0.0), (200.0, 20.0))
    assert match.line.alpha_rad == pytest.approx(expected.alpha_rad)
    assert match.line.c_m == pytest.approx(expected.c_m)


def test_a_newer_part_of_the_map_keeps_the_history():
    stacked = LinkNetwork(STACKED)
    matcher = LinkMatcher(LinkNetwork(STACKED[1:]))
    drive(matcher, [(100, 1.5), (200, 1.5)])
    matcher.replace_network(stacked)
    match = matcher.step((205.0, 1.5, 0.0), covariance(), travelled_m=105.0)
    assert (match.status, match.link_id) == ("matched", "viaduct")


def test_only_links_within_the_radius_come_into_question():
    assert set(LinkNetwork(CROSS).projections(40.0, 0.0, 20.0)) == {1, 2}


@settings(max_examples=50)
@given(
    st.floats(-300, 300), st.floats(-300, 300), st.floats(-4, 4), st.floats(0.1, 60.0), st.floats(0.01, 3.0)
)
def test_whatever_the_pose_the_match_is_consistent(east, north, yaw, sigma, yaw_sigma):
    matcher = LinkMatcher(LinkNetwork(CROSS))
    match = matcher.step((east, north, yaw), np.diag([sigma**2, sigma**2, yaw_sigma**2]), travelled_m=0.0)
    if match.status == "none":
        assert match.link_id is None
        assert match.line is None
    else:
        assert match.link_id in match.candidates
    if match.status == "matched" and match.level is not None:
        assert match.level == next(k.level for k in CROSS if k.link_id == match.link_id)


@pytest.mark.parametrize("name", ["east_m", "north_m", "yaw_rad", "travelled_m"])
def test_what_is_not_finite_is_refused_by_name(name):
    values = {"east_m": 0.0, "north_m": 0.0, "yaw_rad": 0.0, "travelled_m": 0.0, name: math.nan}
    *place, travelled_m = values.values()
    with pytest.raises(ValueError, match=f"^{name}:"):
        LinkMatcher(ROAD).step(tuple(place), covariance(), travelled_m=travelled_m)


def test_links_that_are_no_links_are_refused():
    with pytest.raises(ValueError, match=r"^vertices_m: expected shape"):
        a_link("one", ("a", "b"), (0, 0))
    with pytest.raises(ValueError, match=r"^vertices_m: every element"):
        a_link("nan", ("a", "b"), (0, 0), (math.nan, 1))
    with pytest.raises(ValueError, match=r"^sigma_m:"):
        a_link("sigma", ("a", "b"), (0, 0), (1, 1), sigma_m=0.0)
    with pytest.raises(ValueError, match="has no length"):
        LinkNetwork([a_link("point", ("a", "b"), (0, 0), (0, 0))])


def test_an_empty_map_has_no_links():
    assert LinkMatcher(LinkNetwork([])).step((0.0, 0.0, 0.0), covariance(), travelled_m=0.0).status == "none"


ANGLES = st.floats(-math.pi, math.pi)
METRES = st.floats(-200.0, 200.0)


@given(METRES, METRES, ANGLES, METRES)
def test_the_normal_is_the_derivative_of_the_offset(east, north, alpha, c):
    line, step = LinkLine(alpha, c), 1e-3
    by_east = (line.offset_m(east + step, north) - line.offset_m(east - step, north)) / (2 * step)
    by_north = (line.offset_m(east, north + step) - line.offset_m(east, north - step)) / (2 * step)
    assert line.normal == pytest.approx((by_east, by_north), abs=1e-9)


def test_the_offset_is_positive_to_the_left_of_the_link_and_negative_to_its_right():
    line = line_through((0.0, 0.0), (10.0, 0.0))
    assert line.offset_m(5.0, 2.0) == pytest.approx(2.0)
    assert line.offset_m(5.0, -2.0) == pytest.approx(-2.0)


@given(METRES, METRES, METRES, METRES, ANGLES)
def test_a_line_does_not_move_when_the_origin_does(east, north, origin_e, origin_n, alpha):
    line = LinkLine(alpha, 3.0)
    moved = line.shifted(origin_e, origin_n)
    assert moved.offset_m(east - origin_e, north - origin_n) == pytest.approx(line.offset_m(east, north))


@pytest.mark.parametrize("seed", range(5))
def test_the_kalman_update_is_weighted_least_squares(seed):
    """CN101360971 eq. (9) to (13): minimise |X - x|² in Q_x plus |z - h X|² in the noise; two rows or one by one."""
    rng = np.random.default_rng(seed)
    x, h, z = rng.uniform(-5, 5, 3), rng.standard_normal((2, 3)), rng.standard_normal(2)
    root, noise = np.eye(3) + 0.3 * rng.standard_normal((3, 3)), np.diag([0.3, 0.002])
    p = root @ root.T
    both, one_by_one = (FilterState(PoseModel()) for _ in range(2))
    both.x, both.p = one_by_one.x, one_by_one.p = x, p
    both.update(h, z, noise)
    expected = np.linalg.inv(np.linalg.inv(p) + h.T @ np.linalg.inv(noise) @ h)
    np.testing.assert_allclose(both.p, expected, atol=1e-9)
    np.testing.assert_allclose(both.x, x + expected @ h.T @ np.linalg.inv(noise) @ z, atol=1e-9)
    for row in (0, 1):
        rest = z[[row]] - h[[row]] @ (one_by_one.x - x)
        one_by_one.update(h[[row]], rest, noise[row : row + 1, row : row + 1])
    np.testing.assert_allclose(both.x, one_by_one.x, atol=1e-10)
    np.testing.assert_allclose(both.p, one_by_one.p, atol=1e-10)
