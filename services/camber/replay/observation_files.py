"""Files of raw observations cut into epochs, byte for byte, by as little of their content as says when.

RINEX: a header, then a block from each epoch's line to the next, which begins with `>` (IGS/RTCM, "RINEX", 3.04, table
A3), in RINEX 2 with the date (2.11, table A2). UBX: frames up to
the last of an epoch that has a time: RXM-RAWX, and NAV messages with a time of week (u-blox UBX-18010854, 3.15, 3.17).
SBF: blocks up to the last of MeasEpoch and the position's of one time (Septentrio mosaic-X5 reference guide, 4.1.3).
RTCM 3: frames up to the last MSM of an epoch (RTCM 10403.3, 3.5.16.2). What carries no time goes with the epoch after
it, in RINEX with that before it.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Literal

from camber.formats.broadcast.ephemeris_fields import gps_ns_near
from camber.formats.errors import FormatError
from camber.formats.receiver.frame_buffer import Frame, FrameBuffer
from camber.formats.rinex.compressed_files import rinex_chunks
from camber.formats.rinex.version2_lines import full_year
from camber.formats.rtcm.msm_reader import is_msm
from camber.formats.sbf.block_time import block_time_ns
from camber.formats.sbf.reader import MEAS_EPOCH, PVT_BLOCKS, block_number
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK, CalendarTime, gps_ns_from_gpst
from camber.replay.arrivals import TimedBytes

RawProtocol = Literal["rinex", "ubx", "sbf", "rtcm"]

_END_OF_HEADER = re.compile(rb"^.{60}END OF HEADER[^\n]*\n", re.MULTILINE)
_FIRST_EPOCH = re.compile(rb"^.{48}(...).{9}TIME OF FIRST OBS", re.MULTILINE)
_EPOCH = re.compile(
    rb"^> (\d{4}) ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d) ?([ \d]\d)\.(\d{7})[^\n]{2}[016]", re.MULTILINE
)
_EPOCH_OF_VERSION_2 = re.compile(
    rb"^ ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d)\.(\d{7})  [016][ \d]{2}\d", re.MULTILINE
)
_OFFSET_NS = {b"GPS": 0, b"GAL": 0, b"QZS": 0, b"IRN": 0, b"   ": 0, b"BDT": 14 * NS_PER_SECOND}

_RAWX = b"\x02\x15"
_RAWX_HEAD = struct.Struct("<dH")
# Class NAV: where iTOW stands in the messages that have it.
_TIME_OF_WEEK_AT = {
    **dict.fromkeys((0x01, 0x02, 0x03, 0x04, 0x07, 0x11, 0x12, 0x20, 0x21, 0x22, 0x35, 0x36, 0x43, 0x61), 0),
    **dict.fromkeys((0x13, 0x14, 0x3C), 4),
}
_SAME_EPOCH_NS = 20_000_000
"""A receiver's clock is a few ms off the time of week that it rounds; epochs are 40 ms apart at least."""
_CHUNK_BYTES = 1 << 16  # chosen: the kind of a large file is seen at once
_MS_PER_WEEK = NS_PER_WEEK // 1_000_000
_GLONASS, _BEIDOU = 108, 112  # an MSM's number without its last digit

_EXPECTED_EPOCHS = {
    "rinex": "at least one, from a line '> yyyy mm dd …', in RINEX 2 ' yy mm dd …'",
    "ubx": "at least one RXM-RAWX",
    "sbf": "at least one MeasEpoch",
    "rtcm": "at least one MSM",
}

_Marks = Iterable[tuple[int, int]]
"""(end of what carries a time, that time), in the file's order."""


def read_observation_file(path: Path, near_ns: int | None) -> tuple[RawProtocol, bytes, list[TimedBytes]]:
    """Protocol, header (RINEX only) and the epochs in the file's order; together they are the file, unpacked.

    RTCM does not say the week: `near_ns` must be within half a week of its first epoch. Raises FormatError for another
    format or where there is no epoch, OSError where the file cannot be read.
    """
    protocol, data = read_raw_file(path)
    if protocol == "rinex":
        header = _rinex_header(path.name, data)
        begins = [*_rinex_begins(path.name, data, header), (len(data), 0)]
        marks: _Marks = ((end, time_ns) for (_, time_ns), (end, _) in pairwise(begins))
        epochs = _cut(data, len(header), marks)
    else:
        if protocol == "rtcm" and near_ns is None:
            expected = "another file of the drive that gives the date: RTCM 3 does not"
            raise FormatError(path.name, "week", expected)
        frames = _frames(data)
        if protocol == "rtcm":
            marks = _rtcm_marks(frames, near_ns or 0)
        else:
            marks = _ubx_marks(frames) if protocol == "ubx" else _sbf_marks(frames)
        header, epochs = b"", _cut(data, 0, marks)
    if not epochs:
        raise FormatError(path.name, "epochs", _EXPECTED_EPOCHS[protocol])
    return protocol, header, epochs


def read_raw_file(path: Path) -> tuple[RawProtocol, bytes]:
    """A file unpacked, and what it is by its content. Raises FormatError, OSError."""
    data = b"".join(rinex_chunks(path))
    if data[60:80].startswith(b"RINEX VERSION"):
        return "rinex", data
    for frame in _frames(data):
        if frame.protocol != "nmea":
            return frame.protocol, data
    raise FormatError(path.name, "format", "RINEX 2, 3 or 4, UBX, SBF or RTCM 3", actual=data[:20])


def _cut(data: bytes, begin: int, marks: _Marks) -> list[TimedBytes]:
    """What lies between the marks; neighbours of one time are one epoch, what is left goes with the last."""
    spans: list[tuple[int, int, int]] = []
    for end, time_ns in marks:
        if spans and abs(time_ns - spans[-1][0]) <= _SAME_EPOCH_NS:
            spans[-1] = (spans[-1][0], spans[-1][1], end)
        else:
            spans.append((time_ns, spans[-1][2] if spans else begin, end))
    if spans:
        spans[-1] = (*spans[-1][:2], len(data))
    return [TimedBytes(time_ns, data[start:end]) for time_ns, start, end in spans]


def _rinex_header(name: str, data: bytes) -> bytes:
    end = _END_OF_HEADER.search(data)
    version = data[:9].strip()
    if not version.startswith((b"2", b"3", b"4")) or data[20:21] != b"O":
        raise FormatError(name, "version", "observations in RINEX 2, 3 or 4", actual=data[:21])
    if end is None:
        raise FormatError(name, "header", "a line END OF HEADER")
    return data[: end.end()]


def _rinex_begins(name: str, data: bytes, header: bytes) -> Iterator[tuple[int, int]]:
    """Where each epoch's line begins, and its time. A line that is no date begins nothing."""
    first = _FIRST_EPOCH.search(header)
    system = b"   " if first is None else first[1]
    offset_ns = _OFFSET_NS.get(system)
    if offset_ns is None:
        raise FormatError(name, "time system", "GPS, GAL, QZS, IRN or BDT", actual=system)
    version_2 = data[:9].strip().startswith(b"2")
    for line in (_EPOCH_OF_VERSION_2 if version_2 else _EPOCH).finditer(data, len(header)):
        year, month, day, hour, minute, second, fraction = (int(text) for text in line.groups())
        date = full_year(year) if version_2 else year, month, day
        try:
            time_ns = gps_ns_from_gpst(
                CalendarTime(*date, hour=hour, minute=minute, second=second, nanosecond=100 * fraction)
            )
        except ValueError:
            continue
        yield line.start(), time_ns + offset_ns


def _frames(data: bytes) -> Iterator[Frame]:
    """All UBX, SBF and RTCM 3 frames whose checksums are right."""
    buffer = FrameBuffer("ubx", "sbf", "rtcm")
    for start in range(0, len(data), _CHUNK_BYTES):
        yield from buffer.feed(data[start : start + _CHUNK_BYTES])
    yield from buffer.finish()


def _ubx_marks(frames: Iterable[Frame]) -> Iterator[tuple[int, int]]:
    near_ns: int | None = None
    for frame in frames:
        kind, payload, end = frame.data[2:4], frame.data[6:-2], frame.byte_offset + len(frame.data)
        if frame.protocol != "ubx":
            continue
        if kind == _RAWX and len(payload) >= _RAWX_HEAD.size:
            of_week_s, week = _RAWX_HEAD.unpack_from(payload)
            if 0.0 <= of_week_s < 604_800.0:
                near_ns = week * NS_PER_WEEK + round(of_week_s * NS_PER_SECOND)
                yield end, near_ns
        elif kind[0] == 0x01 and near_ns is not None:
            at = _TIME_OF_WEEK_AT.get(kind[1], len(payload))
            of_week_ms = int.from_bytes(payload[at : at + 4], "little")
            if len(payload) >= at + 4 and of_week_ms < _MS_PER_WEEK:
                yield end, gps_ns_near("G", of_week_ms * 1_000_000, near_ns)


def _sbf_marks(frames: Iterable[Frame]) -> Iterator[tuple[int, int]]:
    """Blocks of positions from the first MeasEpoch on, as with UBX."""
    observed = False
    for frame in frames:
        number = block_number(frame.data) if frame.protocol == "sbf" else None
        observed |= number == MEAS_EPOCH
        if not observed or number not in (MEAS_EPOCH, *PVT_BLOCKS):
            continue
        try:
            time_ns = block_time_ns(frame.data[8:])
        except ValueError:
            continue
        if time_ns is not None:
            yield frame.byte_offset + len(frame.data), time_ns


def _rtcm_marks(frames: Iterable[Frame], near_ns: int) -> Iterator[tuple[int, int]]:
    """Each MSM. GLONASS counts another day: one between the others is of their epoch."""
    open_ns: int | None = None
    for frame in frames:
        payload, end = frame.data[3:-3], frame.byte_offset + len(frame.data)
        number = int.from_bytes(payload[:2], "big") >> 4
        if frame.protocol != "rtcm" or not is_msm(number) or len(payload) < 10:
            continue
        more = bool(payload[6] & 0x02)
        if number // 10 == _GLONASS:
            if open_ns is not None:
                yield end, open_ns
        else:
            of_week_ms = int.from_bytes(payload[3:7], "big") >> 2
            if of_week_ms >= _MS_PER_WEEK:
                continue
            system = "C" if number // 10 == _BEIDOU else "G"
            open_ns = near_ns = gps_ns_near(system, of_week_ms * 1_000_000, near_ns)
            yield end, near_ns
        open_ns = open_ns if more else None
