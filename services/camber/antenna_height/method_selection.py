"""The method whose height is published, and the reason where it is not the configured one."""

from __future__ import annotations

from typing import Literal

from camber.antenna_height.available_heights import Heights
from camber.antenna_height.flatness import Flatness
from camber.schemas.antenna import AntennaHeight, HeightMethod

_AUTOMATIC: dict[bool, tuple[HeightMethod, ...]] = {
    True: ("ranging", "scan_matching", "stroke", "fixed"),
    False: ("scan_matching", "ranging", "stroke", "fixed"),
}
"""By whether the road is flat the preferred method and its substitutes (JP7707657B2, third embodiment)."""


def select_method(
    configured: HeightMethod | Literal["automatic"], heights: Heights, flatness: Flatness
) -> tuple[HeightMethod | None, str]:
    """Return the method whose height is published and, where it is not the preferred one, why.

    A configured method has no substitute: such a vehicle has none.
    """
    if configured != "automatic":
        return (configured, "") if configured in heights.known else (None, heights.missing[configured])
    order = _AUTOMATIC[flatness.flat is not False]
    first = next((method for method in order if method in heights.known), None)
    why = flatness.reason or "road not known"
    if first == order[0]:
        return first, "" if flatness.reason else why
    reason = f"{why}; {heights.missing[order[0]]}"
    return first, reason if first is None else f"{reason}: {first} instead"


def antenna_height_message(
    time_ns: int, selected: tuple[HeightMethod | None, str], heights: Heights, *, disagreement: str
) -> AntennaHeight:
    """Return the message. A disagreement is no height, whichever method was selected."""
    method, reason = selected
    chosen = None if method is None else heights.known[method]
    others = tuple(height for height in heights.known.values() if height is not chosen)
    if disagreement:
        everything = others if chosen is None else (chosen, *others)
        return AntennaHeight(
            time_ns=time_ns, status="disagreement", reason=disagreement[:500], others=everything
        )
    if chosen is None:
        return AntennaHeight(time_ns=time_ns, status="unknown", reason=reason[:500], others=others)
    return AntennaHeight(
        time_ns=time_ns, status="known", reason=reason[:500], others=others, **chosen.model_dump()
    )
