"""Rows and shapes of the report's charts: those of the live page, and what only a finished drive has."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from camber.formats.drive.recording import Recorded
from camber.formats.drive.truth_csv import WRONG_M
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.live.history import RowBlock, TableLayout, columns_of, encoded_rows
from camber.live.rows import CHANNELS, LAYOUTS, TERMS, RowWriter
from camber.replay.run_folder import DriveFacts
from camber.road_map.release import Release
from camber.schemas.base import Float64, Int64
from camber.validation.localization_columns import LocalizerRecord
from camber.validation.reference_trajectory import ReferenceTrajectory
from camber.validation.report.road_shapes import road_shapes

CHART_CHANNELS = tuple(name for name in CHANNELS if name != "scan_match_points")
"""Channels that are drawn, and all that are evaluated; points of scan matches would be most of the page."""
MOST_EPOCHS = 10_000
"""Rows of a table before some are left out. Chosen: 17 minutes at 10 Hz, and about 4 MB of the page."""
_MOST_SNAPSHOTS = 1_000  # of satellites; chosen: 17 minutes at 1 Hz, 1.4 MB of the page
_EVENT_S = 1e-3  # rows of one epoch have one time, to the microsecond of float64


@dataclass(slots=True, kw_only=True)
class SatelliteSnapshots:
    """Satellites by time, as the sky plot reads them."""

    kept: list[Any] = field(default_factory=list)

    def add(self, kind: str, time_s: float, data: bytes) -> None:
        """Keep those of a time."""
        if kind == "satellites":
            self.kept.append(json.loads(data))


@dataclass(slots=True, kw_only=True)
class ChartTables:
    """Tables of rows by name, as `RowWriter` fills them, and the judge's own texts by row of `verdict`."""

    snapshots: SatelliteSnapshots = field(default_factory=SatelliteSnapshots)

    layouts: list[TableLayout] = field(default_factory=lambda: list(LAYOUTS))
    exact: dict[str, list[Sequence[float]]] = field(default_factory=dict)
    rest: dict[str, list[Sequence[float]]] = field(default_factory=dict)
    texts: list[str] = field(default_factory=list)

    def append(self, table: str, exact: Sequence[float], rest: Sequence[float], text: str = "") -> None:
        """Append a row; `text` goes with rows of the table `verdict`."""
        self.exact.setdefault(table, []).append(exact)
        self.rest.setdefault(table, []).append(rest)
        if table == "verdict":
            self.texts.append(text)

    def add_table(self, name: str, exact: dict[str, Float64], rest: dict[str, Float64]) -> None:
        """Add a whole table by its columns (n,), the first exact one the time."""
        self.layouts.append(TableLayout(name=name, exact=tuple(exact), rest=tuple(rest)))
        self.exact[name] = np.column_stack([*exact.values()]).tolist()
        self.rest[name] = np.column_stack([*rest.values()]).tolist() if rest else [()] * len(self.exact[name])

    def sort(self) -> None:
        """Put all tables into the order of time."""
        for name, rows in self.exact.items():
            order = sorted(range(len(rows)), key=lambda at: rows[at][0])
            self.exact[name] = [rows[at] for at in order]
            self.rest[name] = [self.rest[name][at] for at in order]
            if name == "verdict":
                self.texts = [self.texts[at] for at in order]

    def block(self, layout: TableLayout) -> RowBlock:
        """A table as arrays."""
        rows = self.exact.get(layout.name, [])
        exact = np.array(rows, np.float64).reshape(len(rows), len(layout.exact))
        rest = np.array(self.rest.get(layout.name, []), np.float64).reshape(len(rows), len(layout.rest))
        with np.errstate(over="ignore"):  # beyond float32: drawn as infinite, which is what it is
            return RowBlock(layout.name, 0, exact, rest.astype(np.float32))


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartData:
    """What the page embeds, and what of the drive it leaves out, in words."""

    rows: str
    facts: dict[str, Any]
    left_out: str


def chart_data(
    recorded: Mapping[str, Sequence[Recorded[Any]]],
    drive: DriveFacts,
    truth: ReferenceTrajectory | None,
    release: Release | None,
) -> ChartData:
    """Rows of a recording by channel, thinned beyond `MOST_EPOCHS`, and the roads beneath them. Raises ReleaseError."""
    tables = filled_tables(recorded, drive, truth)
    blocks = {layout.name: tables.block(layout) for layout in tables.layouts}
    event_s = _event_times_s(blocks)
    kept = {name: _kept(block, event_s) for name, block in blocks.items()}
    thinned = [
        block._replace(exact=block.exact[kept[name]], rest=block.rest[kept[name]])
        for name, block in blocks.items()
    ]
    track = np.radians(
        np.vstack([block.exact[:, 1:3] for block in thinned if block.table in ("verdict", "position")])
    )
    texts = [tables.texts[row] for row in kept["verdict"].tolist()] if tables.texts else []
    facts = {
        "title": drive.drive,
        "truth": truth is not None,
        "wrong_m": WRONG_M,
        "columns": columns_of(tables.layouts),
        "terms": TERMS,
        "satellites": tables.snapshots.kept[:: _step(len(tables.snapshots.kept), _MOST_SNAPSHOTS)],
        "texts": {row: text for row, text in enumerate(texts) if text},
        "roads": None if release is None else road_shapes(release, track[:, 0], track[:, 1]),
    }
    data = base64.b64encode(encoded_rows(thinned, 0)).decode("ascii")
    return ChartData(
        rows=data, facts=facts, left_out=_left_out(len(kept["position"]), len(blocks["position"].exact))
    )


def filled_tables(
    recorded: Mapping[str, Sequence[Recorded[Any]]], drive: DriveFacts, truth: ReferenceTrajectory | None
) -> ChartTables:
    """All rows of a recording in the order of time: the live page's, scan matches, antenna heights, the truth."""
    tables = ChartTables()
    writer = RowWriter(tables, truth, drive.offset_enu_m)
    for channel, item in _in_order_of_arrival(recorded):
        writer.add(channel, item.message)
    _add_localizer(tables, LocalizerRecord.from_recording(recorded))
    places = np.zeros((0, 3)) if truth is None else _track(truth)
    tables.add_table("truth", dict(zip(("t", "lat", "lon"), places.T, strict=True)), {})
    tables.sort()
    return tables


def _track(truth: ReferenceTrajectory) -> Float64:
    """Time, latitude and longitude (n, 3) in seconds and degrees."""
    return np.column_stack(
        (_unix_s(truth.time_ns), np.degrees(truth.latitude_rad), np.degrees(truth.longitude_rad))
    )


def _in_order_of_arrival(recorded: Mapping[str, Sequence[Recorded[Any]]]) -> list[tuple[str, Recorded[Any]]]:
    items = [(channel, item) for channel in CHART_CHANNELS for item in recorded.get(channel, ())]
    return sorted(items, key=lambda pair: pair[1].arrival_ns)


def _add_localizer(tables: ChartTables, record: LocalizerRecord) -> None:
    """Tables of scan matches by layer and of antenna heights by method, NaN where there is none."""
    matches = record.matches
    layers = {f"layer_{k}_m": column for k, column in enumerate(matches.layer_mean_distance_m.T, 1)}
    tables.add_table("scan_match", {"t": _unix_s(matches.time_ns)}, layers)
    time_ns = np.unique(np.concatenate([np.zeros(0, np.int64), *(at for at, _ in record.heights.values())]))
    columns = {}
    for method, (at_ns, height_m) in record.heights.items():
        columns[method] = np.full(len(time_ns), np.nan)
        columns[method][np.searchsorted(time_ns, at_ns)] = height_m
    tables.add_table("height", {"t": _unix_s(time_ns)}, columns)


def _unix_s(time_ns: Int64) -> Float64:
    return np.array([unix_ns_from_gps_ns(t) / 1e9 for t in time_ns.tolist()], np.float64)


def _event_times_s(blocks: Mapping[str, RowBlock]) -> Float64:
    """Times of wrong fixes, erroneous verdicts and errors beyond their level: what a reader must not miss."""
    names = {layout.name: layout.rest for layout in LAYOUTS}

    def column(table: str, name: str) -> Float64:
        return blocks[table].rest[:, names[table].index(name)].astype(np.float64)

    erroneous = TERMS["verdict"].index("erroneous")
    wrong = (column("verdict", "error_m") > WRONG_M) | (column("verdict", "verdict") == erroneous)
    beyond = column("position", "error_m") > column("position", "hpl_m")
    times_s = np.unique(
        np.concatenate((blocks["verdict"].exact[wrong, 0], blocks["position"].exact[beyond, 0]))
    )
    return times_s[:: _step(len(times_s), MOST_EPOCHS)]


def _kept(block: RowBlock, event_s: Float64) -> Int64:
    """Rows that stay: all of a short table; of a long one each of so many, and those of events."""
    time_s = block.exact[:, 0]
    step = _step(len(time_s), MOST_EPOCHS)
    if step == 1:
        return np.arange(len(time_s))
    near = np.searchsorted(event_s, time_s - _EVENT_S) < np.searchsorted(event_s, time_s + _EVENT_S)
    return np.flatnonzero((np.arange(len(time_s)) % step == 0) | near)


def _step(count: int, most: int) -> int:
    """One of how many stays, so that no more than so many do."""
    return max(1, math.ceil(count / most))


def _left_out(kept: int, of: int) -> str:
    if kept == of:
        return ""
    return (
        f"Charts show {kept:,} of {of:,} epochs: one of {_step(of, MOST_EPOCHS)}, and every one with a wrong fix, "
        "an erroneous verdict or an error beyond its protection level. Tables count all."
    )
