"""Texts of the engine's warnings for an operator."""

from __future__ import annotations

from collections import Counter

from camber.gnss.position.rtk_engine import Engine, EngineWarning

_MOST_NAMED = 10  # chosen: what fits one line of health
HELP: dict[EngineWarning, str] = {
    "base_silent": "no epoch of the base received yet",
    "base_stale": "the base's last epoch is older than longest_base_age_s",
    "base_out_of_order": "of the base, late or repeated; two streams in one?",
    "base_time_went_back": "of the base; restarted?",
    "base_position_missing": "expected 1005, 1006 or a RINEX header in its stream, or base_ecef_m",
    "rover_out_of_order": "late or repeated",
    "rover_time_went_back": "the receiver's clock was set",
    "rover_clock_step": "the receiver stepped its clock; harmless",
}
"""Text after the number of epochs, unless there is a more specific one."""


class EngineWarnings:
    """Reports each warning whenever its count has increased."""

    def __init__(self) -> None:
        self._reported: Counter[EngineWarning] = Counter()
        self._refused = 0

    def new(self, engine: Engine) -> list[tuple[str, str]]:
        """Code and text of the warnings since the last call."""
        texts = [
            (str(name), f"{count} epochs; {_detail(name, engine)}")
            for name, count in engine.warnings.items()
            if count > self._reported[name]
        ]
        self._reported = Counter(engine.warnings)
        refused = engine.ephemerides.refused
        if refused.total() > self._refused:
            self._refused = refused.total()
            texts.append(("ephemeris_refused", ", ".join(f"{why} {n}" for why, n in sorted(refused.items()))))
        return texts


def _detail(warning: EngineWarning, engine: Engine) -> str:
    if warning == "ephemeris_missing":
        missing = sorted(engine.missing_ephemerides().items())
        more = f" and {len(missing) - _MOST_NAMED} more" if len(missing) > _MOST_NAMED else ""
        return ", ".join(f"{satellite} {why}" for satellite, why in missing[:_MOST_NAMED]) + more
    if warning == "base_position_wrong":
        return f"its coordinate: {engine.base.coordinate_error()}"
    if warning == "base_moved":
        return f"its coordinate: {engine.base.move}; confirmed_bases accepts {engine.base.name}"
    return HELP.get(warning, "")
