"""Which way's height is passed on, and with what words where it is another one than was asked for, or none."""

from __future__ import annotations

from typing import Literal

from camber.antenna_height.available_heights import Heights
from camber.antenna_height.flatness import Flatness
from camber.schemas.antenna import AntennaHeight, HeightMethod

_AUTOMATIC: dict[bool, tuple[HeightMethod, ...]] = {
    True: ("ranging", "scan_matching", "stroke", "fixed"),
    False: ("scan_matching", "ranging", "stroke", "fixed"),
}
"""By whether the road is flat (H, embodiment 5), the way that is taken and what stands in for it."""


def chosen_way(
    asked: HeightMethod | Literal["automatic"], heights: Heights, flatness: Flatness
) -> tuple[HeightMethod | None, str]:
    """The way whose height is passed on and, where that is not the one asked for, why. A way that was named is taken,
    or none: whoever names one has a vehicle for which no other stands in."""
    if asked != "automatic":
        return (asked, "") if asked in heights.known else (None, heights.missing[asked])
    order = _AUTOMATIC[flatness.flat is not False]
    first = next((way for way in order if way in heights.known), None)
    why = flatness.reason or "road not known"
    if first == order[0]:
        return first, "" if flatness.reason else why
    reason = f"{why}; {heights.missing[order[0]]}"
    return first, reason if first is None else f"{reason}: {first} instead"


def antenna_height(
    time_ns: int, way: HeightMethod | None, reason: str, heights: Heights, disagreement: str
) -> AntennaHeight:
    """The message. A disagreement is no height, whichever way was chosen."""
    chosen = None if way is None else heights.known[way]
    others = tuple(one for one in heights.all() if one is not chosen)
    if disagreement:
        everybody = others if chosen is None else (chosen, *others)
        return AntennaHeight(
            time_ns=time_ns, status="disagreement", reason=disagreement[:500], others=everybody
        )
    if chosen is None:
        return AntennaHeight(time_ns=time_ns, status="unknown", reason=reason[:500], others=others)
    return AntennaHeight(
        time_ns=time_ns,
        status="known",
        reason=reason[:500],
        way=chosen.way,
        height_m=chosen.height_m,
        sigma_m=chosen.sigma_m,
        others=others,
    )
