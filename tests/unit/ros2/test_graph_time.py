"""Simulated time is this machine's less a constant, as long as it runs as fast."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.ros2.graph_time import GraphTime

NS = 1_000_000_000
NOW_NS = 1_700_000_000 * NS
STARTS_NS = [0, 1_500_000_000 * NS, NOW_NS + 10 * NS]


def test_without_simulation_the_time_is_that_of_the_machine() -> None:
    assert GraphTime(simulated=False).ahead_ns == 0


def test_before_its_first_time_nothing_is_known() -> None:
    graph = GraphTime(simulated=True)
    assert graph.ahead_ns is None
    assert graph.set(5 * NS, NOW_NS) is None
    assert graph.ahead_ns == NOW_NS - 5 * NS


@pytest.mark.parametrize("start_ns", STARTS_NS)
@given(delays_ns=st.lists(st.integers(0, NS // 2), min_size=1, max_size=50))
def test_delays_of_messages_change_nothing(start_ns: int, delays_ns: list[int]) -> None:
    graph = GraphTime(simulated=True)
    assert graph.set(start_ns, NOW_NS + delays_ns[0]) is None
    ahead_ns = graph.ahead_ns
    for k, delay_ns in enumerate(delays_ns):
        assert graph.set(start_ns + k * NS, NOW_NS + k * NS + delay_ns) is None
    assert graph.ahead_ns == ahead_ns


@pytest.mark.parametrize("step_s", [-3600.0, -0.75, 0.75, 3600.0])
def test_a_step_is_followed_and_given(step_s: float) -> None:
    graph = GraphTime(simulated=True)
    graph.set(100 * NS, NOW_NS)
    assert graph.set(101 * NS + round(step_s * NS), NOW_NS + NS) == step_s
    assert graph.ahead_ns == NOW_NS - 100 * NS - round(step_s * NS)
    assert graph.set(102 * NS + round(step_s * NS), NOW_NS + 2 * NS) is None


def test_time_of_double_rate_is_one_step_after_another() -> None:
    graph = GraphTime(simulated=True)
    steps = [graph.set(2 * k * NS // 10, NOW_NS + k * NS // 10) for k in range(31)]
    assert [step for step in steps if step is not None] == pytest.approx([0.6] * 5)
