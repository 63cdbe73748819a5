"""Text table of the status of a vehicle."""

from __future__ import annotations

from collections.abc import Sequence

from camber.schemas.health import Health
from camber.tools.operate.status_view import ChannelRow, ServiceRow, StatusView, last_issue

_WAITING = ("fixes_waiting", "uploads_not_stored", "uploads_waiting", "queue_waiting")
_UNITS = ((1.0, "ms", 1e-3), (120.0, "s", 1.0), (7200.0, "min", 60.0), (172_800.0, "h", 3600.0))
"""Limit up to which a unit is used, and its size [s]; chosen: at most three digits."""
_MOST_TEXT = 70  # chosen: a row fits a wide terminal


def as_text(view: StatusView, now_ns: int) -> str:
    """Return the table of services, the table of channels, and notes."""
    name = "the cloud" if view.vehicle == "fleet" else f"vehicle {view.vehicle}"
    parts = [name, *_services(view.services, now_ns), "", *_channels(view.channels)]
    return "\n".join([*parts, *(["", *view.notes] if view.notes else [])])


def fleet_text(vehicles: dict[str, frozenset[str]]) -> str:
    """Return the vehicles of the fleet that are on the bus."""
    if not vehicles:
        return "no vehicle is on this bus"
    rows = [(name, ", ".join(sorted(services))) for name, services in sorted(vehicles.items())]
    return "\n".join(_table([("vehicle", "services"), *rows]))


def duration(seconds: float) -> str:
    """Return a duration with two digits in a suitable unit."""
    for limit_s, unit, size in _UNITS:
        if seconds < limit_s:
            return f"{seconds / size:.2g} {unit}" if seconds < 10.0 * size else f"{seconds / size:.0f} {unit}"
    return f"{seconds / 86_400.0:.0f} d"


def _services(rows: Sequence[ServiceRow], now_ns: int) -> list[str]:
    head = ("service", "state", "up", "version", "memory", "lag", "waiting", "map", "last issue")
    cells = [("",) * 6 + (row.why,) if row.health is None else _cells(row.health, now_ns) for row in rows]
    return _table([head, *((row.service, row.state, *rest) for row, rest in zip(rows, cells, strict=True))])


def _cells(health: Health, now_ns: int) -> tuple[str, ...]:
    gauges = health.gauges
    memory, lag_s = gauges.get("memory_bytes"), gauges.get("loop_lag_s")
    waiting = sum(use.waiting for use in health.channels) + sum(gauges.get(name, 0.0) for name in _WAITING)
    return (
        duration(health.uptime_s),
        health.version,
        "" if memory is None else f"{memory / 1e6:.0f} MB",
        "" if lag_s is None else duration(lag_s),
        f"{waiting:.0f}",
        health.facts.get("map_release", ""),
        _last_issue(health, now_ns),
    )


def _last_issue(health: Health, now_ns: int) -> str:
    issue = last_issue(health)
    if issue is None:
        return ""
    ago = duration(max(now_ns - (issue.last_time_ns or now_ns), 0) / 1e9)
    text = f"{issue.code} ×{issue.count}, {ago} ago"
    detail = " ".join(issue.text.split())[:_MOST_TEXT]
    return f"{text}: {detail}" if detail else text


def _channels(rows: Sequence[ChannelRow]) -> list[str]:
    table = [("channel", "from", "to", "Hz", "of", "age", "waiting", "refused")]
    for row in rows:
        refused = ", ".join(f"{count} {reason}" for reason, count in sorted(row.refused.items()) if count)
        age = "never" if row.age_s is None else duration(row.age_s)
        table.append(
            (
                row.channel,
                ", ".join(sorted(row.producers)),
                ", ".join(sorted(row.received_s_ago)),
                "" if row.rate_hz is None else f"{row.rate_hz:.1f}",
                "" if row.table_rate_hz is None else f"{row.table_rate_hz:g}",
                f"{age}, late" if row.late else age,
                f"{row.waiting}",
                refused,
            )
        )
    return _table(table)


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
