"""The receiver's integrity reports of several messages, combined into one `ReceiverIntegrity` message.

Sources: u-blox ZED-F9P, interface description (UBX-18010854): 3.15.13 (NAV-PVT); ZED-F9R, interface description
(UBX-20039643): NAV-PL, SEC-SIG, MON-RF; NMEA 0183 v4.11, 6.3 (GBS).
"""

from __future__ import annotations

from typing import Any

from camber.formats.nmea.sentences import Gbs
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.schemas.base import EARLIEST_NS, LATEST_NS
from camber.schemas.gnss import ReceiverIntegrity

_VALID_NS = 2 * NS_PER_SECOND  # chosen: two epochs at 1 Hz, the lowest rate of these messages
_JAMMING = ("unknown", "none", "warning", "critical")
_SPOOFING = ("unknown", "none", "indicated", "affirmed")


class IntegrityReport:
    """The last report of each kind. Each is valid for two seconds at most, then unknown."""

    def __init__(self) -> None:
        self._reports: dict[str, tuple[int, dict[str, Any]]] = {}

    def update_protection_levels(
        self, time_ns: int, levels_m: tuple[float, float] | None, risk: float | None
    ) -> None:
        """NAV-PL: horizontal and vertical level, None where invalid."""
        horizontal, vertical = levels_m or (None, None)
        self._reports["protection"] = (
            time_ns,
            {
                "horizontal_protection_level_m": horizontal,
                "vertical_protection_level_m": vertical,
                "integrity_risk": None if levels_m is None else risk,
            },
        )

    def update_fix(self, time_ns: int, *, within_masks: bool, authenticated: bool) -> None:
        """NAV-PVT. Not authenticated is unknown: receivers that cannot check report the same."""
        self._reports["fix"] = (
            time_ns,
            {
                "fix_within_masks": "yes" if within_masks else "no",
                "authenticated": "yes" if authenticated else "unknown",
            },
        )

    def update_signal_security(self, time_ns: int, *, jamming: int, spoofing: int) -> None:
        """SEC-SIG: numbers of the states, 0 where detection is disabled."""
        state = _SPOOFING[spoofing] if spoofing < len(_SPOOFING) else "unknown"
        self._reports["signals"] = time_ns, {"jamming": jamming, "spoofing": state}

    def update_front_ends(self, time_ns: int, jamming: list[int]) -> None:
        """MON-RF: the state of each block. With one unknown, the absence of jamming is unknown."""
        worst = max(jamming, default=0)
        self._reports["front_ends"] = time_ns, {"jamming": worst if worst > 1 or 0 not in jamming else 0}

    def update_fault_detection(self, time_ns: int, gbs: Gbs) -> None:
        """GBS. Failed: with a suspect satellite, used in the position or not. Passed: with expected errors only."""
        passed = "unknown" if gbs.expected_error_enu_m is None else "passed"
        self._reports["fault_detection"] = (
            time_ns,
            {
                "raim": passed if gbs.satellite is None else "failed",
                "expected_error_enu_m": gbs.expected_error_enu_m,
                "suspect_satellite": gbs.satellite,
                "suspect_bias_m": gbs.bias_m,
                "suspect_bias_sigma_m": gbs.bias_sigma_m,
                "missed_detection_probability": gbs.missed_detection_probability,
            },
        )

    def at(self, time_ns: int) -> list[ReceiverIntegrity]:
        """Return all valid reports as one message; nothing at times outside a message's range."""
        if not EARLIEST_NS <= time_ns <= LATEST_NS:
            return []
        self._reports = {k: r for k, r in self._reports.items() if abs(time_ns - r[0]) <= _VALID_NS}
        fields = dict[str, Any]()
        jamming = 0
        for _, content in self._reports.values():
            jamming = max(jamming, content.get("jamming", 0))
            fields |= content
        return [ReceiverIntegrity(time_ns=time_ns, **{**fields, "jamming": _JAMMING[jamming]})]
