"""Learning of the height correction `h_e` (H (4), (5)): what map and antenna are off together.

Learnt only from positions that were found right, at a speed outside the stop range (no re-learning at one spot), slowly
and within a cap, so that neither a wrong fix that passed nor a slow drift of all fixes can pull it far.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class LearningRules:
    """Gain `g` of (5), lower edge of the speeds at which is learnt, cap of `h_e`."""

    gain: float = 0.01
    least_speed_m_s: float = 3.0
    cap_m: float = 0.3


@dataclass(frozen=True, slots=True)
class Correction:
    """`h_e` in force, and from how many positions it was learnt."""

    correction_m: float = 0.0
    samples: int = 0


def learn(
    correction: Correction,
    rules: LearningRules,
    *,
    receiver_m: float,
    antenna_m: float,
    road_m: float,
    speed_m_s: float | None,
) -> Correction:
    """One step of (4) and (5): `h_ec = h_r − (h_a + h_m)`, `h_e = (1 − g) h_ep + g h_ec`.

    Returns the correction unchanged where the speed is unknown or within the stop range, and where the new one would
    be beyond the cap.
    """
    if speed_m_s is None or not abs(speed_m_s) >= rules.least_speed_m_s:
        return correction
    observed_m = receiver_m - (antenna_m + road_m)
    learnt_m = (1.0 - rules.gain) * correction.correction_m + rules.gain * observed_m
    if not abs(learnt_m) <= rules.cap_m:
        return correction
    return replace(correction, correction_m=learnt_m, samples=correction.samples + 1)


def text_from_correction(correction: Correction) -> str:
    """As it is kept over a restart."""
    return json.dumps({"correction_m": correction.correction_m, "samples": correction.samples})


def correction_from_text(text: str, rules: LearningRules) -> Correction:
    """The reverse. Raises ValueError that says what was expected: a damaged one must not move the height."""
    table = json.loads(text)
    if not isinstance(table, dict) or set(table) != {"correction_m", "samples"}:
        raise ValueError("expected correction_m and samples")
    correction_m, samples = table["correction_m"], table["samples"]
    if type(correction_m) not in (int, float) or not abs(correction_m) <= rules.cap_m:
        raise ValueError(f"correction_m is {correction_m!r}, expected a number within ±{rules.cap_m} m")
    if type(samples) is not int or samples < 0:
        raise ValueError(f"samples is {samples!r}, expected a count")
    return Correction(float(correction_m), samples)
