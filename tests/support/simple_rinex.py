"""A simple RINEX 3 observation reader that follows the columns of tables A2 and A3: the oracle of reader and writer."""

from __future__ import annotations

from collections.abc import Iterator

from camber.geodesy.gps_time import CalendarTime, gps_ns_from_gpst

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
