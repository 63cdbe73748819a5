"""Verification by the time series (JP7707657B2, second embodiment): does a fix continue the right fixes before it?

A wrong set of integers sets in with a jump of decimetres to metres in 3D. A fix that has moved since the last right one
exactly as the vehicle has, and has risen as the road has, was not put there by new integers; if its height contradicts
the map all the same, it is the height model that is off. The evidence fades with time and with the length of the chain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesRules:
    """How long a right fix vouches for the next, and how well both must agree."""

    longest_gap_s: float = 1.0
    longest_chain: int = 25
    horizontal_m: float = 0.15
    vertical_m: float = 0.12


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainedFix:
    """A fix found right, the road's slope there, and how many fixes back the last confirmed one is."""

    time_ns: int
    latitude_rad: float
    longitude_rad: float
    height_m: float
    slope_east: float
    slope_north: float
    chain_length: int = 0


def continues_chain(
    last: ChainedFix | None,
    rules: SeriesRules,
    *,
    time_ns: int,
    moved_east_m: float,
    moved_north_m: float,
    drift_m: float,
    height_m: float,
) -> bool:
    """Does the fix continue the last right one?

    `moved_*` is the fix's displacement since then, `drift_m` how far that is from the vehicle's by its own sensors;
    the height must have changed by the road's slope at the last fix times the displacement.
    """
    if last is None or last.chain_length >= rules.longest_chain:
        return False
    gap_s = (time_ns - last.time_ns) / 1e9
    if not 0.0 < gap_s <= rules.longest_gap_s:
        return False
    risen_m = last.slope_east * moved_east_m + last.slope_north * moved_north_m
    return drift_m <= rules.horizontal_m and abs(height_m - last.height_m - risen_m) <= rules.vertical_m


def next_in_chain(fix: ChainedFix, last: ChainedFix | None, *, verified: bool) -> ChainedFix:
    """The fix as the head of the chain: a confirmed one starts anew, a verified one is a link more."""
    return replace(fix, chain_length=(last.chain_length + 1 if last is not None else 1) if verified else 0)
