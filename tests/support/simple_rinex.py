"""A simple RINEX 3 observation reader that follows the columns of tables A2 and A3: the oracle of reader and writer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from camber.formats.observations import ObservationEpoch, satellite_name, signal_name
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_gpst

ATTRIBUTES = {"C": "pseudorange_m", "L": "carrier_phase_cycles", "D": "doppler_hz", "S": "cn0_dbhz"}
Values = dict[tuple[str, str], tuple[float, str, str]]


def header_of(text: str) -> tuple[list[str], dict[str, list[str]]]:
    """The labels of a header, and the observation types by system."""
    labels, types, system = [], dict[str, list[str]](), ""
    for line in text.splitlines():
        labels.append(line[60:].strip())
        if labels[-1] == "SYS / # / OBS TYPES":
            system = line[0].strip() or system
            types.setdefault(system, []).extend(line[7:60].split())
        if labels[-1] == "END OF HEADER":
            break
    return labels, types


def epochs_of(text: str) -> Iterator[tuple[int, Values]]:
    """(time ns, {(satellite, type): (value, LLI, SSI)}) of each epoch; all have flag 0."""
    labels, types = header_of(text)
    lines = iter(text.splitlines()[len(labels) :])
    for head in lines:
        assert head[0] == ">"
        assert head[31] == "0"
        whole, fraction = head[18:29].split(".")
        fields = (int(head[a:b]) for a, b in ((2, 6), (7, 9), (10, 12), (13, 15), (16, 18)))
        values: Values = {}
        for _ in range(int(head[32:35])):
            line = next(lines)
            for k, name in enumerate(types.get(line[0], ())):
                cell = line[3 + 16 * k : 19 + 16 * k].ljust(16)
                if cell[:14].strip():
                    values[line[:3], name] = float(cell[:14]), cell[14], cell[15]
        time = CalendarTime(*fields, int(whole), int(fraction) * 100)
        yield gps_ns_from_gpst(time), values


def assert_equal_to_simple_reader(epochs: Sequence[ObservationEpoch], text: str) -> int:
    """Compare every value of the supported systems, zeros left out; return how many there are."""
    expected, count = list(epochs_of(text)), 0
    assert [epoch.time_ns for epoch in epochs] == [time_ns for time_ns, _ in expected]
    for epoch, (_, values) in zip(epochs, expected, strict=True):
        rows: dict[tuple[str, str], dict[str, tuple[float, str]]] = {}
        for (satellite, name), (value, lli, _) in values.items():
            if satellite[0] in "GJECR" and name[0] in ATTRIBUTES and value != 0.0:
                rows.setdefault((satellite, name[1:]), {})[name[0]] = value, lli.strip()
        names = map(satellite_name, epoch.satellite.tolist())
        keys = list(zip(names, map(signal_name, epoch.signal.tolist()), strict=True))
        assert sorted(keys) == sorted(rows)
        for k, row in enumerate(rows[key] for key in keys):
            decoded = [getattr(epoch, attribute)[k] for attribute in ATTRIBUTES.values()]
            np.testing.assert_array_equal(decoded, [row.get(kind, (np.nan,))[0] for kind in ATTRIBUTES])
            lock = int(row["L"][1] or "0") if "L" in row else 0
            assert (epoch.loss_of_lock[k], epoch.half_cycle[k]) == (lock & 1 == 1, lock & 2 == 2)
            count += len(row)
    return count
