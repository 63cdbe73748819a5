"""Streaming statistics of a GNSS recording: times, signals, arcs, ephemerides, positions, receiver integrity.

Reports are plain values for JSON; None means unknown.
"""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import (
    BroadcastEphemeris,
    Integers,
    ObservationEpoch,
    satellite_name,
    signal_name,
)
from camber.formats.receiver.solution import ReceiverSolution
from camber.geodesy.gps_time import gpst_from_gps_ns, text_from_calendar
from camber.gnss.observations.cycle_slips import REASONS, CycleSlipDetector
from camber.gnss.observations.ephemeris_store import is_healthy, refusal
from camber.gnss.observations.epoch_order import EpochOrder, Order
from camber.schemas.gnss import ReceiverIntegrity

MOST_GAPS_SHOWN = 10  # chosen: what fits the report; all are counted
_NS = 1e-9  # seconds in a nanosecond
_NS_PER_MS = 1_000_000  # nanoseconds in a millisecond
_BATCH = 256  # chosen: epochs counted in one vectorized step
_GAP = 1.5  # chosen: a step of more intervals has lost at least one epoch
_STEPS_OF_CN0 = 10  # chosen: 0.1 dB-Hz
_MOST_CN0_DBHZ = 100  # chosen: above the range of RTCM DF408 (64 dB-Hz) and of any receiver
_MEASURED = {
    "code": "pseudorange_m", "phase": "carrier_phase_cycles", "doppler": "doppler_hz", "cn0": "cn0_dbhz",
}  # fmt: skip
_SYSTEM_NAMES = {"G": "GPS", "J": "QZSS", "E": "Galileo", "C": "BeiDou", "R": "GLONASS"}
_INTEGRITY_FIELDS = ("jamming", "spoofing", "raim", "fix_within_masks", "authenticated")


def time_text(time_ns: int) -> str:
    """GPS time as people read it, to a millisecond."""
    return text_from_calendar(gpst_from_gps_ns((time_ns + _NS_PER_MS // 2) // _NS_PER_MS * _NS_PER_MS))


class TimeLine:
    """Times of epochs in the order of the recording: their interval, and where it was not kept."""

    def __init__(self) -> None:
        self._order = EpochOrder()
        self._times_ns = array("q")
        self._repeated = self._late = self._epochs = 0
        self._went_back: list[int] = []

    def add(self, time_ns: int) -> Order:
        """The next epoch; `late` ones count as such only."""
        self._epochs += 1
        order = self._order.admit(time_ns)
        if order == "late":
            repeated = bool(self._times_ns) and self._times_ns[-1] == time_ns
            self._repeated += repeated
            self._late += not repeated
            return order
        if order == "restarted":
            self._went_back.append(time_ns)
        self._times_ns.append(time_ns)
        return order

    def report(self) -> dict[str, Any]:
        """Gaps are steps of more than one and a half intervals; the interval is the median step."""
        times_ns = np.frombuffer(self._times_ns, np.int64)
        first_ns, last_ns = (int(times_ns[0]), int(times_ns[-1])) if times_ns.size else (None, None)
        steps_ns = np.diff(times_ns)
        forward_ns = steps_ns[steps_ns > 0]
        interval_ns = float(np.median(forward_ns)) if forward_ns.size else None
        gaps = np.zeros(0, np.int64) if interval_ns is None else np.flatnonzero(steps_ns > _GAP * interval_ns)
        return {
            "epochs": self._epochs,
            "first_ns": first_ns,
            "last_ns": last_ns,
            "first": None if first_ns is None else time_text(first_ns),
            "last": None if last_ns is None else time_text(last_ns),
            "duration_s": None if first_ns is None or last_ns is None else float(last_ns - first_ns) * _NS,
            "interval_s": None if interval_ns is None else round(interval_ns * _NS, 4),
            "gaps": gaps.size,
            "gaps_s": float(steps_ns[gaps].sum()) * _NS,
            "longest_gap_s": float(steps_ns[gaps].max()) * _NS if gaps.size else None,
            "first_gaps": [
                {"after": time_text(int(times_ns[k])), "length_s": float(steps_ns[k]) * _NS}
                for k in gaps[:MOST_GAPS_SHOWN].tolist()
            ],
            "repeated": self._repeated,
            "late": self._late,
            "time_went_back": [time_text(time_ns) for time_ns in self._went_back[:MOST_GAPS_SHOWN]],
            "times_it_went_back": len(self._went_back),
        }


@dataclass(slots=True, kw_only=True)
class _Signal:
    """One signal of one system: how many epochs, rows, and rows with what."""

    counts: Counter[str] = field(default_factory=Counter)
    satellites: set[int] = field(default_factory=set)
    cn0_sum_dbhz: float = 0.0
    cn0: Integers = field(default_factory=lambda: np.zeros(_MOST_CN0_DBHZ * _STEPS_OF_CN0 + 1, np.int64))

    def report(self, system: str, signal: str) -> dict[str, Any]:
        counts, rows = self.counts, self.counts["rows"]
        return {
            **{"system": system, "signal": signal, "epochs": counts["epochs"], "rows": rows},
            "satellites": sorted(satellite_name(s) for s in self.satellites),
            "cn0_mean_dbhz": round(self.cn0_sum_dbhz / counts["cn0"], 2) if counts["cn0"] else None,
            "cn0_p05_dbhz": _quantile(self.cn0, 0.05),
            "cn0_p95_dbhz": _quantile(self.cn0, 0.95),
            **{f"with_{what}": counts[what] / rows for what in ("code", "phase", "doppler")},
            **{what: counts[what] for what in ("half_cycle", "loss_of_lock", "arcs")},
        }


def _quantile(histogram: Integers, probability: float) -> float | None:
    """To 0.1 dB-Hz."""
    total = int(histogram.sum())
    if not total:
        return None
    place = int(np.searchsorted(np.cumsum(histogram), probability * total))
    return place / _STEPS_OF_CN0


class ObservationSummary:
    """Epochs of one receiver or station. Of late and repeated ones nothing but their number is kept."""

    def __init__(self) -> None:
        self._times = TimeLine()
        self._waiting: list[ObservationEpoch] = []
        self._signals: defaultdict[int, _Signal] = defaultdict(_Signal)
        self._satellites_of_epochs: Counter[int] = Counter()
        self._rows_of_systems: Counter[str] = Counter()
        self._tracker: CycleSlipDetector | None = None
        self._last_arc = 0
        self._epochs = 0

    def add(self, epoch: ObservationEpoch) -> None:
        """The next epoch of the recording."""
        if self._times.add(epoch.time_ns) == "late":
            return
        self._epochs += 1
        self._waiting.append(epoch)
        if len(self._waiting) == _BATCH:
            self._count()

    def report(self) -> dict[str, Any]:
        """All that was counted."""
        self._count()
        signals = {(chr(key >> 16), signal_name(key & 0xFFFF)): each for key, each in self._signals.items()}
        in_order = sorted(signals, key=lambda name: ("GJECR".find(name[0]), name))
        sizes = self._satellites_of_epochs
        begun = np.zeros(len(REASONS), np.int64) if self._tracker is None else self._tracker.begun
        return {
            "time": self._times.report(),
            "satellites_an_epoch": {
                "least": min(sizes, default=None),
                "mean": sum(n * k for n, k in sizes.items()) / self._epochs if self._epochs else None,
                "most": max(sizes, default=None),
            },
            "systems": [
                self._system(letter, [signals[name] for name in in_order if name[0] == letter])
                for letter in dict.fromkeys(letter for letter, _ in in_order)
            ],
            "signals": [signals[name].report(*name) for name in in_order],
            "arcs_begun": {
                reason: int(n) for reason, n in zip(REASONS, begun, strict=True) if reason != "continuous"
            },
        }

    def _system(self, letter: str, signals: Iterable[_Signal]) -> dict[str, Any]:
        satellites = set[int]().union(*(signal.satellites for signal in signals))
        return {
            "system": letter,
            "name": _SYSTEM_NAMES.get(letter, letter),
            "satellites": sorted(map(satellite_name, satellites)),
            "satellites_an_epoch": self._rows_of_systems[letter] / self._epochs,
        }

    def _count(self) -> None:
        """Adds up the epochs that wait."""
        epochs, self._waiting = self._waiting, []
        if not epochs:
            return

        def column(name: str) -> NDArray[Any]:
            return np.concatenate([getattr(epoch, name) for epoch in epochs])

        satellite, signal = column("satellite"), column("signal")
        number = np.repeat(np.arange(len(epochs)), [epoch.satellite.size for epoch in epochs])
        self._count_satellites(number, satellite, len(epochs))
        keys, place = np.unique((satellite >> 8 << 16) + signal, return_inverse=True)
        cn0 = column("cn0_dbhz")
        rows = {
            "rows": np.ones(satellite.size, np.bool_),
            **{name: np.isfinite(column(values)) for name, values in _MEASURED.items()},
            **{name: column(name) for name in ("half_cycle", "loss_of_lock")},
            "arcs": self._arcs_begun(epochs),
        }
        counts = {name: np.bincount(place[mask], minlength=keys.size) for name, mask in rows.items()}
        once = np.unique(number * keys.size + place) % max(keys.size, 1)
        counts["epochs"] = np.bincount(once, minlength=keys.size)
        step = np.clip(np.nan_to_num(cn0) * _STEPS_OF_CN0 + 0.5, 0, _MOST_CN0_DBHZ * _STEPS_OF_CN0)
        for k, key in enumerate(keys.tolist()):
            of_signal, is_of_signal = self._signals[key], place == k
            of_signal.counts.update({name: int(count[k]) for name, count in counts.items()})
            of_signal.satellites.update(np.unique(satellite[is_of_signal]).tolist())
            known = is_of_signal & rows["cn0"]
            of_signal.cn0_sum_dbhz += float(cn0[known].sum())
            of_signal.cn0 += np.bincount(step[known].astype(np.int64), minlength=of_signal.cn0.size)

    def _count_satellites(self, number: Integers, satellite: Integers, epochs: int) -> None:
        each = np.unique((number << 16) + satellite)
        self._satellites_of_epochs.update(np.bincount(each >> 16, minlength=epochs).tolist())
        systems, counts = np.unique((each & 0xFFFF) >> 8, return_counts=True)
        self._rows_of_systems.update(dict(zip(map(chr, systems.tolist()), counts.tolist(), strict=True)))

    def _arcs_begun(self, epochs: list[ObservationEpoch]) -> NDArray[np.bool_]:
        """Of each row, whether an arc begins there."""
        if self._tracker is None:
            times_ns = np.array([epoch.time_ns for epoch in epochs])
            steps_s = np.diff(times_ns) * _NS
            interval_s = float(np.median(steps_s[steps_s > 0])) if (steps_s > 0).any() else 1.0
            # As the engine has it, but a recording of one epoch in 30 s is not all gaps.
            self._tracker = CycleSlipDetector(longest_gap_s=max(2.1, _GAP * interval_s))
        begun = []
        for epoch in epochs:
            arcs = self._tracker.update(epoch)
            begun.append(arcs > self._last_arc)
            self._last_arc = max(self._last_arc, int(arcs.max(initial=0)))
        return np.concatenate(begun)


class EphemerisSummary:
    """Ephemerides by system; the same once more counts once."""

    def __init__(self) -> None:
        self._sets: dict[str, set[tuple[int, int, int]]] = {}
        self._unhealthy: defaultdict[str, set[int]] = defaultdict(set)
        self._refused: Counter[str] = Counter()

    def add(self, ephemeris: BroadcastEphemeris) -> None:
        """One more."""
        letter = chr(ephemeris.satellite >> 8)
        reason = refusal(ephemeris)
        if reason is not None:
            self._refused[reason] += 1
            return
        self._sets.setdefault(letter, set()).add((ephemeris.satellite, ephemeris.toe_ns, ephemeris.iode))
        if not is_healthy(ephemeris):
            self._unhealthy[letter].add(ephemeris.satellite)

    def report(self) -> dict[str, Any]:
        """By system; `refused`: what no orbit can be, by what is wrong with it."""
        systems = []
        for letter in sorted(self._sets, key="GJECR".find):
            sets = self._sets[letter]
            toes_ns = [toe_ns for _, toe_ns, _ in sets]
            systems.append(
                {
                    "system": letter,
                    "name": _SYSTEM_NAMES.get(letter, letter),
                    "ephemerides": len(sets),
                    "satellites": sorted(satellite_name(s) for s in {satellite for satellite, _, _ in sets}),
                    "unhealthy": sorted(map(satellite_name, self._unhealthy[letter])),
                    "first_toe": time_text(min(toes_ns)),
                    "last_toe": time_text(max(toes_ns)),
                }
            )
        return {"systems": systems, "refused": dict(self._refused)}


class PositionSummary:
    """A receiver's or program's own positions."""

    def __init__(self) -> None:
        self._times = TimeLine()
        self._counts, self._qualities = Counter[str](), Counter[str]()
        self._least, self._most = np.full(3, np.inf), np.full(3, -np.inf)
        self._oldest_s: float | None = None

    def add(self, solution: ReceiverSolution) -> None:
        """One more."""
        self._times.add(solution.time_ns)
        self._qualities[solution.quality.name.lower()] += 1
        self._counts["with_covariance"] += solution.covariance_enu_m2 is not None
        self._counts["with_velocity"] += solution.velocity_enu_m_s is not None
        self._counts["with_ratio"] += solution.ratio is not None
        if solution.age_s is not None:
            self._oldest_s = max(solution.age_s, self._oldest_s or 0.0)
        place = (solution.latitude_rad, solution.longitude_rad, solution.height_m)
        self._least, self._most = np.minimum(self._least, place), np.maximum(self._most, place)

    def report(self) -> dict[str, Any] | None:
        """None where there are no positions."""
        if not self._qualities:
            return None
        degrees = np.array([np.degrees(1.0), np.degrees(1.0), 1.0])
        return {
            "time": self._times.report(),
            "by_quality": dict(self._qualities.most_common()),
            **self._counts,
            "oldest_corrections_s": self._oldest_s,
            "least_latitude_longitude_deg_height_m": (self._least * degrees).tolist(),
            "greatest_latitude_longitude_deg_height_m": (self._most * degrees).tolist(),
        }


class StatementSummary:
    """Counts of a receiver's own integrity messages."""

    def __init__(self) -> None:
        self._statements = 0
        self._values: dict[str, Counter[str]] = {name: Counter() for name in _INTEGRITY_FIELDS}
        self._levels_m: dict[str, list[float]] = {}
        self._suspects: Counter[str] = Counter()

    def add(self, statement: ReceiverIntegrity) -> None:
        """One more."""
        self._statements += 1
        for name, values in self._values.items():
            values[getattr(statement, name)] += 1
        for name in ("horizontal_protection_level_m", "vertical_protection_level_m"):
            level_m = getattr(statement, name)
            if level_m is not None:
                least, greatest = self._levels_m.get(name, [level_m, level_m])
                self._levels_m[name] = [min(least, level_m), max(greatest, level_m)]
        if statement.suspect_satellite is not None:
            self._suspects[statement.suspect_satellite] += 1

    def report(self) -> dict[str, Any] | None:
        """Return counts and the range of protection levels; None where there were no messages."""
        if not self._statements:
            return None
        return {
            "statements": self._statements,
            **{name: dict(values.most_common()) for name, values in self._values.items()},
            **self._levels_m,
            "suspect_satellites": dict(self._suspects.most_common()),
        }
