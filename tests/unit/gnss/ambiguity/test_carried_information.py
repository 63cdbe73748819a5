"""Carried ambiguities against one least squares adjustment of all epochs together."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.gnss.ambiguity.carried_information import (
    add_rows,
    at_next_epoch,
    factor,
    no_arcs,
    solution,
    with_new_arcs,
    without,
)
from camber.gnss.observations.differenced_observations import SingleDifferences
from support.single_difference_rows import made_up_rows

S = 1_000_000_000
slow = settings(derandomize=True, deadline=None, max_examples=25)


@dataclass(frozen=True)
class Epoch:
    """Rows, the arc of each (number of its ambiguity), displacement since the epoch before and its information."""

    rows: SingleDifferences
    arc: np.ndarray
    moved_m: np.ndarray
    link: np.ndarray


def drive(rng: np.random.Generator, epochs: int, linked: bool) -> list[Epoch]:
    """Epochs of which each has some of the satellites; arcs break at random."""
    first = made_up_rows(rng, satellites=6, systems="GE")
    n = first.rows.group.size
    numbers, made = np.arange(n), []
    for k in range(epochs):
        breaks = rng.random(n) < 0.05
        numbers = np.where(breaks, 1000 * (k + 1) + np.arange(n), numbers)
        present = np.flatnonzero(rng.random(n) < 0.85)
        place = rng.normal(size=3) * 0.5
        directions = first.rows.direction + 0.02 * k * rng.normal(size=(n, 3))
        rows = SingleDifferences(
            **{
                name: getattr(first.rows, name)[present]
                for name in first.rows._fields
                if name != "atmosphere_m2"
            },
            atmosphere_m2=np.zeros((3, 3)),
        )
        clock = {g: rng.normal() * 100.0 for g in np.unique(rows.group)}
        truth = directions[present] @ place + np.array([clock[g] for g in rows.group])
        float_m = (numbers[present] % 7 - 3.0) * rows.wavelength_m
        rows = rows._replace(
            direction=directions[present],
            code_m=truth + 0.4 * rng.normal(size=present.size),
            phase_m=truth + float_m + 0.004 * rng.normal(size=present.size),
        )
        root = rng.normal(size=(3, 3)) * 3.0
        link = root @ root.T + np.eye(3) if linked else np.zeros((3, 3))
        made.append(Epoch(rows, numbers[present], rng.normal(size=3) * 0.3, link))
    return made


def carried(epochs: list[Epoch]):
    """Numbers of the arcs, μ and C after the last epoch."""
    arcs = no_arcs()
    for k, epoch in enumerate(epochs):
        arcs = at_next_epoch(arcs, np.zeros(3), epoch.moved_m, epoch.link, -1)
        # No displacement changes the linearisation point here.
        new = np.setdiff1d(epoch.arc, arcs.rover_arc)
        arcs = with_new_arcs(arcs, new, new, np.zeros(new.size))
        column = np.array([np.flatnonzero(arcs.rover_arc == a)[0] for a in epoch.arc])
        rows, none = epoch.rows, np.full(column.size, -1)
        add_rows(arcs.information, arcs.vector, rows, column, rows.phase_m, 1.0 / rows.phase_variance_m2)
        add_rows(arcs.information, arcs.vector, rows, none, rows.code_m, 1.0 / rows.code_variance_m2)
        arcs.seen_ns[column] = k * S
    parts = factor(arcs.information, arcs.vector)
    covariance = np.linalg.inv(parts.position_information)
    return arcs.rover_arc, *solution(parts, covariance @ parts.position_vector, covariance)


def batch(epochs: list[Epoch]):
    """The same by one adjustment of all positions, clocks and ambiguities, whose datum is the least norm."""
    numbers = np.unique(np.concatenate([epoch.arc for epoch in epochs]))
    design, value, weight = [], [], []
    clocks = sum(np.unique(epoch.rows.group).size * 2 for epoch in epochs)
    size, clock = numbers.size + 3 * len(epochs) + clocks, numbers.size + 3 * len(epochs)
    for k, epoch in enumerate(epochs):
        rows, at = epoch.rows, numbers.size + 3 * k
        for phase in (True, False):
            groups = np.unique(rows.group)
            for i in range(rows.group.size):
                line = np.zeros(size)
                line[at : at + 3] = rows.direction[i]
                line[clock + np.flatnonzero(groups == rows.group[i])[0]] = 1.0
                if phase:
                    line[np.flatnonzero(numbers == epoch.arc[i])[0]] = 1.0
                design.append(line)
                value.append(rows.phase_m[i] if phase else rows.code_m[i])
                weight.append(1.0 / (rows.phase_variance_m2 if phase else rows.code_variance_m2)[i])
            clock += groups.size
        if k and epoch.link.any():
            root = np.linalg.cholesky(epoch.link).T
            for axis in range(3):
                line = np.zeros(size)
                line[at : at + 3], line[at - 3 : at] = root[axis], -root[axis]
                design.append(line)
                value.append(root[axis] @ epoch.moved_m)
                weight.append(1.0)
    a, y, w = np.array(design), np.array(value), np.sqrt(np.array(weight))
    normal = (a * w[:, None]).T @ (a * w[:, None])
    covariance = np.linalg.pinv(normal, rcond=1e-13, hermitian=True)
    mean = covariance @ (a.T @ (w**2 * y))
    last = numbers.size + 3 * (len(epochs) - 1)
    kept = np.r_[np.arange(numbers.size), last : last + 3]
    return numbers, mean[kept], covariance[np.ix_(kept, kept)]


def differences(epoch: Epoch, numbers: np.ndarray) -> np.ndarray:
    """Operator from the state to the double differences of an epoch and its position."""
    lines = []
    for g in np.unique(epoch.rows.group):
        members = epoch.arc[epoch.rows.group == g]
        for arc in members[1:]:
            line = np.zeros(numbers.size + 3)
            line[np.flatnonzero(numbers == arc)[0]] = 1.0
            line[np.flatnonzero(numbers == members[0])[0]] = -1.0
            lines.append(line)
    return np.vstack([*lines, np.hstack([np.zeros((3, numbers.size)), np.eye(3)])])


@slow
@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.booleans())
def test_the_carried_state_is_that_of_one_adjustment_of_all_epochs(seed, count, linked):
    epochs = drive(np.random.default_rng(seed), count, linked)
    numbers, mean, covariance = carried(epochs)
    all_numbers, all_mean, all_covariance = batch(epochs)
    ours, theirs = differences(epochs[-1], numbers), differences(epochs[-1], all_numbers)
    expected = theirs @ all_covariance @ theirs.T
    sigma = np.sqrt(np.diag(expected))
    assert np.abs(ours @ mean - theirs @ all_mean).max() < 1e-3 * sigma.max() + 1e-6
    got = ours @ covariance @ ours.T
    assert np.abs(got - expected).max() < 1e-3 * np.abs(expected).max()
    assert np.linalg.eigvalsh(got)[0] > 0.0


@slow
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_the_satellites_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    epochs = drive(rng, 5, linked=True)
    turned = []
    for epoch in epochs:
        order = rng.permutation(epoch.arc.size)
        rows = SingleDifferences(
            **{
                name: getattr(epoch.rows, name)[order]
                for name in epoch.rows._fields
                if name != "atmosphere_m2"
            },
            atmosphere_m2=epoch.rows.atmosphere_m2,
        )
        turned.append(Epoch(rows, epoch.arc[order], epoch.moved_m, epoch.link))
    numbers, mean, covariance = carried(epochs)
    other_numbers, other_mean, other_covariance = carried(turned)
    one, other = differences(epochs[-1], numbers), differences(epochs[-1], other_numbers)
    assert other @ other_mean == pytest.approx(one @ mean, abs=1e-6)
    spread = one @ covariance @ one.T
    assert np.abs(other @ other_covariance @ other.T - spread).max() < 1e-6 * np.abs(spread).max()


def test_without_a_link_nothing_of_the_position_is_carried_but_by_phases():
    rng = np.random.default_rng(3)
    epochs = drive(rng, 2, linked=False)
    numbers = np.arange(5000, 5000 + epochs[1].arc.size)
    alone = Epoch(epochs[1].rows, numbers, epochs[1].moved_m, epochs[1].link)
    _, mean, covariance = carried([epochs[0], alone])
    _, expected, expected_covariance = carried([alone])
    assert mean[-3:] == pytest.approx(expected[-3:], abs=1e-6)
    assert covariance[-3:, -3:] == pytest.approx(expected_covariance[-3:, -3:], rel=1e-6)


def test_an_ambiguity_that_is_eliminated_leaves_the_others_as_they_were():
    rng = np.random.default_rng(4)
    epoch = drive(rng, 1, linked=False)[0]
    arcs = with_new_arcs(no_arcs(), epoch.arc, epoch.arc, np.zeros(epoch.arc.size))
    rows, column = epoch.rows, np.arange(epoch.arc.size)
    none = np.full(column.size, -1)
    add_rows(arcs.information, arcs.vector, rows, column, rows.phase_m, 1.0 / rows.phase_variance_m2)
    add_rows(arcs.information, arcs.vector, rows, none, rows.code_m, 1.0 / rows.code_variance_m2)

    def position(information, vector):
        parts = factor(information, vector)
        covariance = np.linalg.inv(parts.position_information)
        return covariance @ parts.position_vector, covariance

    gone = np.zeros(column.size, np.bool_)
    gone[3] = True
    before, after = (
        position(arcs.information, arcs.vector),
        position(*without(arcs.information, arcs.vector, gone)),
    )
    for one, other in zip(before, after, strict=True):
        assert other == pytest.approx(one, rel=1e-6, abs=1e-9)
