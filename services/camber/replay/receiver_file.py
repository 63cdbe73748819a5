"""A receiver's file cut into what came at one time, byte for byte and in the file's order."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.nmea.epochs import read_nmea
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution
from camber.geodesy.gps_time import NS_PER_DAY, NS_PER_SECOND, utc_from_gps_ns
from camber.replay.arrivals import TimedBytes
from camber.schemas.drive import ReceiverFile

_NMEA_TIME = re.compile(rb"^\$..(?:GGA|RMC|GST|GNS),(\d\d)(\d\d)(\d\d)(?:\.(\d{1,9}))?,")

_AROUND = 3  # epochs before and after, of which most must be sound
_AHEAD_NS = 60 * NS_PER_SECOND  # a recording may have gaps; a clock that is wrong is wrong by more


def read_receiver_file(receiver: ReceiverFile) -> tuple[bytes, list[TimedBytes]]:
    """What stands before the first epoch, and the epochs in the file's order, late and repeated ones too.

    Lines without a time that can be read (headers, damaged lines) go with the epoch after them. Raises FormatError
    where there is no epoch at all, OSError where the file cannot be read.
    """
    lines = receiver.file.read_bytes().splitlines(keepends=True)
    times = _pos_times(receiver, lines) if receiver.format == "pos" else _nmea_times(receiver, lines)
    preamble = b""
    epochs: list[TimedBytes] = []
    waiting: list[bytes] = []
    for line, time_ns in zip(lines, times, strict=True):
        waiting.append(line)
        if time_ns is None:
            continue
        if not epochs:
            preamble = b"".join(waiting[:-1])
            waiting = waiting[-1:]
        if epochs and receiver.format == "nmea" and epochs[-1].time_ns == time_ns:
            epochs[-1] = TimedBytes(time_ns, epochs[-1].payload + b"".join(waiting))
        else:
            epochs.append(TimedBytes(time_ns, b"".join(waiting)))
        waiting = []
    if not epochs:
        raise FormatError(
            receiver.file.name, "epochs", f"at least one position in the format {receiver.format}"
        )
    epochs[-1] = TimedBytes(epochs[-1].time_ns, epochs[-1].payload + b"".join(waiting))
    return preamble, epochs


def receive_times(time_ns: Sequence[int]) -> list[int]:
    """When each arrived, were it sent at once: the running maximum of the times measured.

    A time far ahead of the epochs around it is a fault of the sender's clock: it arrives with the one before it. So is
    one more than a day off the median of all.
    """
    if not time_ns:
        return []
    times = np.array(time_ns, dtype=np.int64)
    around = min(_AROUND, len(times) - 1)
    near = np.lib.stride_tricks.sliding_window_view(np.pad(times, around, mode="reflect"), 2 * around + 1)
    expected = np.median(near, axis=1)
    believed = (times <= expected + _AHEAD_NS) & (np.abs(times - np.median(times)) <= NS_PER_DAY)
    first = times[np.argmax(believed)] if believed.any() else np.median(times).astype(np.int64)
    running = np.maximum.accumulate(np.where(believed, times, first))
    return [int(t) for t in np.maximum(running, first)]


def _pos_times(receiver: ReceiverFile, lines: Sequence[bytes]) -> list[int | None]:
    decoder = PosDecoder(receiver.file.name)
    solved = ([r.time_ns for r in decoder.feed(line) if isinstance(r, ReceiverSolution)] for line in lines)
    return [times_ns[-1] if times_ns else None for times_ns in solved]


def _nmea_times(receiver: ReceiverFile, lines: Sequence[bytes]) -> list[int | None]:
    """Sentences carry the time of day; the day comes from the first position that can be dated."""
    solutions = read_nmea(receiver.file, utc_date=receiver.utc_date)
    dated = next((s.time_ns for s in solutions if isinstance(s, ReceiverSolution)), None)
    if dated is None:
        return [None] * len(lines)
    utc = utc_from_gps_ns(dated)
    at_day_ns = ((utc.hour * 60 + utc.minute) * 60 + utc.second) * NS_PER_SECOND + utc.nanosecond
    days = [_time_of_day_ns(line) for line in lines]
    first = next((i for i, day_ns in enumerate(days) if day_ns == at_day_ns), 0)
    return _unwrap(days[:first][::-1], at_day_ns, dated)[::-1] + _unwrap(days[first:], at_day_ns, dated)


def _unwrap(days: Sequence[int | None], at_day_ns: int, time_ns: int) -> list[int | None]:
    """Times from times of day, each within half a day of the one before, beginning beside a known one."""
    times: list[int | None] = []
    for day_ns in days:
        if day_ns is None:
            times.append(None)
            continue
        time_ns += (day_ns - at_day_ns + NS_PER_DAY // 2) % NS_PER_DAY - NS_PER_DAY // 2
        at_day_ns = day_ns
        times.append(time_ns)
    return times


def _time_of_day_ns(line: bytes) -> int | None:
    match = _NMEA_TIME.match(line)
    if match is None:
        return None
    hour, minute, second, decimals = match.groups()
    whole_s = (int(hour) * 60 + int(minute)) * 60 + int(second)
    return whole_s * NS_PER_SECOND + int((decimals or b"").ljust(9, b"0"))
