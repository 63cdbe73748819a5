"""Ambiguities over time: a state of floats, and beside it a hypothesis of integers that later epochs may refute.

The floats (`carried_information`) never get an integer, so nothing wrong persists in them. Integers that pass all tests
of a fix begin a *hypothesis*: a second state, the floats given these integers. It is carried by the same rows, resolves
new arcs from a position of centimetres, and gives the fix, once fixes made without it have supported it for
`support_fixes` epochs and `support_ns`. It is given up

- where the floats contradict its position (χ², three degrees of freedom);
- where a fix without it, of the floats or of the epoch by itself, is elsewhere: then nothing is fixed in this epoch, as
  one of both is wrong and which one is not known, and the next fix begins another hypothesis;
- with its arcs: it never outlives them.

So wrong integers last until the next fix made without them, or until the floats are precise enough to contradict them.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from camber.formats.observations import Floats, Integers
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.ambiguity.ambiguity_resolution import RESOLVED, FixCriteria
from camber.gnss.ambiguity.carried_information import CarriedArcs, no_arcs
from camber.gnss.ambiguity.fixed_solution import CONTRADICTORY, NO_POSITION, Estimate
from camber.gnss.observations.differenced_observations import Noise
from camber.gnss.observations.signal_pairs import GROUPS
from camber.gnss.position.carried_solution import (
    LONGEST_GAP_NS,
    NO_LINK,
    CarriedEpoch,
    CarriedParameters,
    EpochRows,
    PositionLink,
    carried_epoch,
    with_integers,
)
from camber.gnss.position.doppler_prior import EcefVelocity, displacement
from camber.gnss.position.float_solution import inverse_3

AmbiguityMode = Literal["single_epoch", "carried"]
"""Of a fix: `single_epoch` where its integers are those of the epoch by itself."""
_SATELLITES = 128  # 64 of a system, and QZSS in the groups of GPS
_SAME_M = 0.3  # chosen: fixes with the same integers differ by centimetres, by a wavelength times a dilution otherwise
_LARGEST_CHI2 = 42.0
"""Of the floats against the hypothesis. Chosen: 21.1 is 1 in 10,000, and twice that since codes in streets are worse
than their variances."""


class HoldRules(NamedTuple):
    """When a hypothesis gives the fix: after so many fixes without it at its place, over so long. Chosen: reflections
    change within a second of driving, so that five fixes of a second are not of one and the same error."""

    support_fixes: int = 5
    support_ns: int = NS_PER_SECOND


class _Hypothesis(NamedTuple):
    """The state given integers, since when, and how many fixes without it have supported it."""

    arcs: CarriedArcs
    since_ns: int
    support: int


class CarriedAmbiguities:
    """The two states from epoch to epoch."""

    def __init__(self, noise: Noise, criteria: FixCriteria, rules: HoldRules | None = None) -> None:
        self._parameters, self._criteria = CarriedParameters(noise), criteria
        self._rules = rules or HoldRules()
        self.reset()

    def reset(self) -> None:
        """Forget everything: the receiver or the base was restarted, or the base has moved."""
        self._arcs = no_arcs()
        self._hypothesis: _Hypothesis | None = None
        self._code_ns = np.zeros((GROUPS, _SATELLITES), np.int64)
        self._last_ns = 0
        self._velocity: EcefVelocity | None = None

    def arcs(self) -> list[tuple[int, int]]:
        """Arcs of the floats, by their numbers at rover and base."""
        return list(zip(self._arcs.rover_arc.tolist(), self._arcs.base_arc.tolist(), strict=True))

    def solve(
        self, epoch: EpochRows, alone: Estimate, velocity: EcefVelocity | None
    ) -> tuple[AmbiguityMode, Estimate]:
        """The estimate of an epoch, and its mode; `alone` is that of the epoch by itself, which has a position."""
        if not 0 < epoch.time_ns - self._last_ns <= LONGEST_GAP_NS:
            self.reset()
        motion = self._motion(velocity, epoch.time_ns)
        held = None
        if self._hypothesis is not None:
            held = self._carry(self._hypothesis.arcs, self._code_ns.copy(), epoch, motion)
        floats = self._carry(self._arcs, self._code_ns, epoch, motion)
        self._arcs, self._velocity, self._last_ns = floats.arcs, velocity, epoch.time_ns
        direct = _without_hypothesis(floats.estimate, alone)
        if held is not None:
            of_hypothesis = self._test_hypothesis(epoch, held, floats.estimate, direct[1])
            if of_hypothesis is not None:
                return "carried", of_hypothesis
        if direct[1].status == RESOLVED and self._hypothesis is None:
            arcs = with_integers(floats.arcs, epoch, direct[1].integer)
            self._hypothesis = _Hypothesis(arcs, epoch.time_ns, 1)
        return direct

    def _carry(
        self, arcs: CarriedArcs, code_ns: Integers, epoch: EpochRows, motion: PositionLink
    ) -> CarriedEpoch:
        return carried_epoch(
            arcs, code_ns, epoch, motion, criteria=self._criteria, parameters=self._parameters
        )

    def _motion(self, velocity: EcefVelocity | None, time_ns: int) -> PositionLink:
        if self._velocity is None or velocity is None:
            return NO_LINK
        moved_m, covariance_m2 = displacement(self._velocity, velocity, time_ns - self._last_ns)
        return PositionLink(moved_m, inverse_3(covariance_m2)[0])

    def _test_hypothesis(
        self, epoch: EpochRows, held: CarriedEpoch, floats: Estimate, direct: Estimate
    ) -> Estimate | None:
        """The estimate where the hypothesis decides it: its fix, or none where another fix contradicts it."""
        hypothesis, estimate = self._hypothesis, held.estimate
        assert hypothesis is not None
        if estimate.status != RESOLVED:
            self._hypothesis = None if direct.status == RESOLVED else hypothesis._replace(arcs=held.arcs)
            return None
        if not _agrees(floats, estimate.dx_m):
            self._hypothesis = None
            return None
        supported = direct.status == RESOLVED
        if supported and not _distance_m(estimate.dx_m, direct.dx_m) < _SAME_M:
            self._hypothesis = None
            return floats._replace(status=CONTRADICTORY)
        self._hypothesis = hypothesis = _Hypothesis(
            with_integers(held.arcs, epoch, estimate.integer),
            hypothesis.since_ns,
            hypothesis.support + supported,
        )
        lasts_ns = epoch.time_ns - hypothesis.since_ns
        ripe = hypothesis.support >= self._rules.support_fixes and lasts_ns >= self._rules.support_ns
        return estimate if ripe else None


def _without_hypothesis(floats: Estimate, alone: Estimate) -> tuple[AmbiguityMode, Estimate]:
    """The fix of the floats, else that of the epoch by itself where the floats do not contradict it."""
    if floats.status == NO_POSITION:
        return "single_epoch", alone
    if floats.status != RESOLVED and alone.status == RESOLVED and _agrees(floats, alone.dx_m):
        return "single_epoch", alone
    return "carried", floats


def _agrees(floats: Estimate, dx_m: Floats) -> bool:
    """Whether a position (3,) is within the float position's covariance."""
    apart_m = dx_m - floats.float_dx_m
    return float(apart_m @ np.linalg.solve(floats.float_covariance_m2, apart_m)) < _LARGEST_CHI2


def _distance_m(one_m: Floats, other_m: Floats) -> float:
    return float(np.linalg.norm(one_m - other_m))
