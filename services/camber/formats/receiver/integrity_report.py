"""What a receiver says of its own integrity, in several messages, as the one message that Camber carries.

Sources: u-blox ZED-F9P, interface description (UBX-18010854): 3.15.13 (NAV-PVT); ZED-F9R, interface description
(UBX-20039643): NAV-PL, SEC-SIG, MON-RF; NMEA 0183 v4.11, 6.3 (GBS).
"""

from __future__ import annotations

from typing import Any

from camber.formats.nmea.sentences import Gbs
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.schemas.base import EARLIEST_NS, LATEST_NS
from camber.schemas.gnss import ReceiverIntegrity

_HELD_NS = 2 * NS_PER_SECOND
_JAMMING = ("unknown", "none", "warning", "critical")
_SPOOFING = ("unknown", "none", "indicated", "affirmed")


class IntegrityReport:
    """The last statement of each kind. Each holds for two seconds at most: then it is not known any more."""

    def __init__(self) -> None:
        self._said: dict[str, tuple[int, dict[str, Any]]] = {}

    def say_protection_levels(
        self, time_ns: int, levels_m: tuple[float, float] | None, risk: float | None
    ) -> None:
        """NAV-PL: horizontal and vertical, None where the receiver says that they are not valid."""
        horizontal, vertical = (None, None) if levels_m is None else levels_m
        self._said["protection"] = (
            time_ns,
            {
                "horizontal_protection_level_m": horizontal,
                "vertical_protection_level_m": vertical,
                "integrity_risk": None if levels_m is None else risk,
            },
        )

    def say_fix(self, time_ns: int, *, within_masks: bool, authenticated: bool) -> None:
        """NAV-PVT. Not authenticated says nothing: receivers that cannot check say the same."""
        content = {
            "fix_within_masks": "yes" if within_masks else "no",
            "authenticated": "yes" if authenticated else "unknown",
        }
        self._said["fix"] = time_ns, content

    def say_signal_security(self, time_ns: int, jamming: int, spoofing: int) -> None:
        """SEC-SIG: the states' numbers, 0 where the detection is not enabled."""
        content: dict[str, Any] = {
            "jamming": jamming,
            "spoofing": _SPOOFING[spoofing] if spoofing < 4 else "unknown",
        }
        self._said["signals"] = time_ns, content

    def say_front_ends(self, time_ns: int, jamming: list[int]) -> None:
        """MON-RF: the state of each block. One that is not known leaves open whether none is jammed."""
        worst = max(jamming, default=0)
        self._said["front_ends"] = time_ns, {"jamming": worst if worst > 1 or 0 not in jamming else 0}

    def say_fault_detection(self, time_ns: int, gbs: Gbs) -> None:
        """GBS. Failed: a satellite is named, whether the position still uses it or not.

        Passed: expected errors, and no satellite named.
        """
        raim = "unknown" if gbs.expected_error_enu_m is None else "passed"
        if gbs.satellite is not None:
            raim = "failed"
        self._said["fault_detection"] = (
            time_ns,
            {
                "raim": raim,
                "expected_error_enu_m": gbs.expected_error_enu_m,
                "suspect_satellite": gbs.satellite,
                "suspect_bias_m": gbs.bias_m,
                "suspect_bias_sigma_m": gbs.bias_sigma_m,
                "missed_detection_probability": gbs.missed_detection_probability,
            },
        )

    def at(self, time_ns: int) -> list[ReceiverIntegrity]:
        """All that holds at this time, as one message; none at times that no message may have."""
        if not EARLIEST_NS <= time_ns <= LATEST_NS:
            return []
        self._said = {k: s for k, s in self._said.items() if abs(time_ns - s[0]) <= _HELD_NS}
        fields = dict[str, Any]()
        jamming = 0
        for _, content in self._said.values():
            jamming = max(jamming, content.get("jamming", 0))
            fields |= content
        return [ReceiverIntegrity(time_ns=time_ns, **{**fields, "jamming": _JAMMING[jamming]})]
