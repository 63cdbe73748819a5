"""Format the report of `camber gnss inspect` as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

_LABEL_WIDTH = 14  # chosen: the longest label and a space
_NOT_KNOWN = "not known"
_INTEGRITY_LABELS = {"raim": "RAIM", "fix_within_masks": "within masks", "authenticated": "authentic"}


def text_of(report: dict[str, Any]) -> str:
    """A page of aligned lines without an end of line."""
    lines = [f"{report['file']}: {_format(report)}, {_size(report['bytes'])}"]
    lines += _section("header", _header(report["header"]))
    for observed in report["observations"]:
        of = "" if observed["of"] == "file" else f" of {observed['of']}"
        lines += _section(f"observations{of}", _observations(observed, report["week_from"]))
    if report["epochs_of_further_stations"]:
        lines += ["", f"epochs of further stations: {report['epochs_of_further_stations']}"]
    lines += _section("reference stations", map(_station, report["reference_stations"]))
    lines += _section("ephemerides", _ephemerides(report))
    lines += _section("positions", _positions(report["positions"], report["baselines"]))
    lines += _section("the receiver on its own integrity", _integrity(report["integrity"]))
    lines += _section("messages", _columns(report["messages"]))
    lines += _section("left out", _columns(report["counters"]))
    lines += _section("problems", _problems(report["problems"]))
    return "\n".join(lines)


def _format(report: dict[str, Any]) -> str:
    version = (report["header"] or {}).get("version")
    return report["format"] if version is None else f"{report['format']}, version {version:.2f}"


def _size(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1_000_000 else f"{size / 1e3:.1f} kB"


def _section(title: str, lines: Iterator[str]) -> list[str]:
    indented = [f"  {line}".rstrip() for line in lines]
    return ["", title, *indented] if indented else []


def _row(label: str, value: object) -> str:
    return f"{label:<{_LABEL_WIDTH}}{value}"


def _header(header: dict[str, Any] | None) -> Iterator[str]:
    if header is None:
        return
    for name in ("marker", "receiver", "antenna"):
        if name in header:
            yield _row(name, header[name] or _NOT_KNOWN)
    if "position" in header:
        yield _row("position", _place(header["position"]))
        if header["antenna_height_east_north_m"] is not None:
            up_m, east_m, north_m = header["antenna_height_east_north_m"]
            yield _row("antenna at", f"{up_m:.4f} m up, {east_m:.4f} m east, {north_m:.4f} m north of it")
        interval_s = header["interval_s"]
        yield _row("interval", _NOT_KNOWN if interval_s is None else f"{interval_s:g} s")
    if header["leap_seconds"] is not None:
        yield _row("leap seconds", header["leap_seconds"])


def _place(position: dict[str, float] | None) -> str:
    if position is None:
        return _NOT_KNOWN
    return (
        f"{position['latitude_deg']:.7f}° {position['longitude_deg']:.7f}°, "
        f"{position['height_m']:.3f} m above the ellipsoid"
    )


def _times(time: dict[str, Any]) -> Iterator[str]:
    yield _row("epochs", f"{time['epochs']:,}")
    if time["first"] is None:
        return
    yield _row("from, to", f"{time['first']} to {time['last']} GPS time ({_duration(time['duration_s'])})")
    interval_s = time["interval_s"]
    if interval_s is not None:
        rate = f" ({1.0 / interval_s:.4g} Hz)" if 0.0 < interval_s <= 1.0 else ""
        yield _row("interval", f"{interval_s:g} s{rate}")
    if time["gaps"]:
        together = f"{time['gaps']:,}, together {_duration(time['gaps_s'])}"
        yield _row("gaps", f"{together}, the longest {_duration(time['longest_gap_s'])}")
        for gap in time["first_gaps"]:
            yield _row("", f"{_duration(gap['length_s'])} after {gap['after']}")
        if time["gaps"] > len(time["first_gaps"]):
            yield _row("", "…")
    else:
        yield _row("gaps", "none")
    if time["repeated"] or time["late"]:
        yield _row("out of order", f"{time['repeated']:,} repeated, {time['late']:,} late epochs")
    if time["times_it_went_back"]:
        to = ", ".join(time["time_went_back"])
        yield _row("time went back", f"{time['times_it_went_back']:,} times, to {to}")


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.6g} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    parts = [(days, "d"), (hours, "h"), (minutes, "min"), (rest, "s")]
    return " ".join(f"{n} {unit}" for n, unit in parts if n)


def _observations(observed: dict[str, Any], week_from: str) -> Iterator[str]:
    yield from _times(observed["time"])
    if week_from == "file date":
        text = "guessed from the date of the file, the recording does not say it; --date settles it"
        yield _row("week", text)
    each = observed["satellites_an_epoch"]
    if each["mean"] is None:
        return
    yield _row("satellites", f"{each['mean']:.1f} an epoch ({each['least']} to {each['most']})")
    yield ""
    systems = [
        [s["name"], str(len(s["satellites"])), f"{s['satellites_an_epoch']:.1f}", " ".join(s["satellites"])]
        for s in observed["systems"]
    ]
    yield from _table(["system", ">satellites", ">an epoch", ""], systems)
    yield ""
    head = ["signal", ">epochs", ">satellites", ">rows", ">C/N0 mean", ">5 %", ">95 %", ">code", ">phase"]
    yield from _table(
        [*head, ">Doppler", ">half cycle", ">lost lock", ">arcs"], list(map(_signal, observed["signals"]))
    )
    begun = {reason.replace("_", " "): n for reason, n in observed["arcs_begun"].items() if n}
    yield ""
    yield _row("arcs begun", _counted(begun) or "none")


def _signal(s: dict[str, Any]) -> list[str]:
    levels = (s["cn0_mean_dbhz"], s["cn0_p05_dbhz"], s["cn0_p95_dbhz"])
    return [
        f"{s['system']} {s['signal']}",
        f"{s['epochs']:,}",
        str(len(s["satellites"])),
        f"{s['rows']:,}",
        *("–" if level is None else f"{level:.1f}" for level in levels),
        *(_percent(s[f"with_{what}"]) for what in ("code", "phase", "doppler")),
        f"{s['half_cycle']:,}",
        f"{s['loss_of_lock']:,}",
        f"{s['arcs']:,}",
    ]


def _percent(share: float) -> str:
    """Only all of it is written as 100, only nothing as 0."""
    if share in (0.0, 1.0):
        return f"{share:.0%}"
    return f"{min(max(share, 0.001), 0.999):.1%}"


def _station(station: dict[str, Any]) -> str:
    height_m = station["antenna_height_m"]
    above = "" if height_m is None else f", antenna {height_m:.4f} m above the marker"
    x, y, z = station["position_ecef_m"]
    return (
        f"{station['station']}: {_place(station['position'])} (ECEF {x:.4f} {y:.4f} {z:.4f}){above}, "
        f"sent {station['times_said']:,} times"
    )


def _ephemerides(report: dict[str, Any]) -> Iterator[str]:
    rows = []
    for s in report["ephemerides"]["systems"]:
        times, unhealthy = f"{s['first_toe']} to {s['last_toe']}", " ".join(s["unhealthy"]) or "–"
        rows.append([s["name"], f"{s['ephemerides']:,}", str(len(s["satellites"])), times, unhealthy])
    if rows:
        yield from _table(["system", ">sets", ">satellites", "reference times", "unhealthy"], rows)
    if report["ephemerides"]["refused"]:
        yield _row("refused", _counted(report["ephemerides"]["refused"]))
    if report["ionosphere"]:
        yield _row("ionosphere", "coefficients of " + ", ".join(report["ionosphere"]))


def _positions(positions: dict[str, Any] | None, baselines: int) -> Iterator[str]:
    if positions is not None:
        yield from _times(positions["time"])
        yield _row("quality", _counted(positions["by_quality"]))
        parts = ("covariance", "velocity", "ratio")
        yield _row("with", ", ".join(f"{positions[f'with_{part}']:,} {part}" for part in parts))
        if positions["oldest_corrections_s"] is not None:
            yield _row("corrections", f"up to {positions['oldest_corrections_s']:g} s old")
        least = positions["least_latitude_longitude_deg_height_m"]
        most = positions["greatest_latitude_longitude_deg_height_m"]
        yield _row("latitude", f"{least[0]:.7f}° to {most[0]:.7f}°")
        yield _row("longitude", f"{least[1]:.7f}° to {most[1]:.7f}°")
        yield _row("height", f"{least[2]:.3f} to {most[2]:.3f} m above the ellipsoid")
    if baselines:
        yield _row("baselines", f"{baselines:,}")


def _integrity(integrity: dict[str, Any] | None) -> Iterator[str]:
    if integrity is None:
        return
    yield _row("statements", f"{integrity['statements']:,}")
    for key in ("jamming", "spoofing", "raim", "fix_within_masks", "authenticated"):
        yield _row(_INTEGRITY_LABELS.get(key, key), _counted(integrity[key]))
    for axis in ("horizontal", "vertical"):
        levels_m = integrity.get(f"{axis}_protection_level_m")
        if levels_m is not None:
            yield _row(axis, f"protection level {levels_m[0]:.2f} to {levels_m[1]:.2f} m")
    if integrity["suspect_satellites"]:
        yield _row("suspects", _counted(integrity["suspect_satellites"]))


def _problems(problems: dict[str, Any]) -> Iterator[str]:
    yield from problems["first"]
    more = problems["count"] - len(problems["first"])
    if more:
        yield f"… and {more:,} more"


def _counted(counts: dict[str, int]) -> str:
    return ", ".join(f"{count:,} {name}" for name, count in counts.items())


def _columns(counts: dict[str, int]) -> Iterator[str]:
    """Counts with their names, two a line."""
    cells = [f"{name:<34}{count:>9,}" for name, count in counts.items()]
    for k in range(0, len(cells), 2):
        yield "    ".join(cells[k : k + 2])


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Format columns at their minimum width; a heading that begins with > is right-aligned."""
    right = [name.startswith(">") for name in head]
    lines = [[name.removeprefix(">") for name in head], *rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    for line in lines:
        columns = zip(line, widths, right, strict=True)
        cells = (text.rjust(width) if to_right else text.ljust(width) for text, width, to_right in columns)
        yield "  ".join(cells).rstrip()
