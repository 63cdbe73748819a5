"""What the engine found amiss, in words for an operator."""

from __future__ import annotations

from collections import Counter

from camber.gnss.position.rtk_engine import Engine, Warning_

_MOST_NAMED = 10
HELP: dict[Warning_, str] = {
    "base_silent": "no epoch of the base has come yet",
    "base_stale": "the base's last epoch is older than longest_base_age_s",
    "base_out_of_order": "of the base, late or twice; two streams in one?",
    "base_time_went_back": "of the base; restarted?",
    "base_position_missing": "expected 1005, 1006 or a RINEX header in its stream, or base_ecef_m",
    "base_position_wrong": "it is nowhere on earth",
    "rover_out_of_order": "late or twice",
    "rover_time_went_back": "the receiver's clock was set",
    "rover_clock_step": "the receiver set its clock; nothing depends on it",
}
"""What is said beside the number of epochs, where nothing more is known."""


class EngineWarnings:
    """Tells each warning again whenever it has happened again."""

    def __init__(self) -> None:
        self._told: Counter[Warning_] = Counter()
        self._refused = 0

    def new(self, engine: Engine) -> list[tuple[str, str]]:
        """Code and text of what has happened since the last call."""
        happened = [(name, count) for name, count in engine.warnings.items() if count > self._told[name]]
        self._told = Counter(engine.warnings)
        told = [(str(name), f"{count} epochs; {_detail(name, engine)}") for name, count in happened]
        refused = engine.ephemerides.refused
        if refused.total() > self._refused:
            self._refused = refused.total()
            told.append(("ephemeris_refused", ", ".join(f"{why} {n}" for why, n in sorted(refused.items()))))
        return told


def _detail(warning: Warning_, engine: Engine) -> str:
    if warning == "ephemeris_missing":
        lacks = sorted(engine.lacks().items())
        more = f" and {len(lacks) - _MOST_NAMED} more" if len(lacks) > _MOST_NAMED else ""
        return ", ".join(f"{satellite} {why}" for satellite, why in lacks[:_MOST_NAMED]) + more
    if warning == "base_position_wrong" and engine.base.miss_m is not None:
        return f"its own single point is {engine.base.miss_m:.0f} m away"
    return HELP.get(warning, "")
