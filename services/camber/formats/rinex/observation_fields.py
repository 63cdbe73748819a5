"""Fields of RINEX observation lines, compiled: line ends, integers, F14.3, indicators, times, satellites.

Source: IGS/RTCM, "RINEX", versions 3.04 (2018) and 4.02 (2024), table A3. Lines are bytes (n,) from `start` to, not
including, `end`. Every access is within these bounds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.geodesy.gps_time import NS_PER_SECOND

Bytes = NDArray[np.uint8]

# Results of `thousandths`, outside the range of F14.3: no value; malformed.
BLANK = -(10**15)
BAD = BLANK - 1
EPOCH_LINE_BYTES = 35
"""Length of an epoch line up to its number of lines (table A3)."""
ZERO, GREATER = 48, 62
_CR, _NEWLINE, _SPACE, _PLUS, _MINUS, _POINT = 13, 10, 32, 43, 45, 46
_PICOSECONDS_OFFSET = 57  # RINEX 4.02, table A3
_GPS_EPOCH_DAY = 723_125  # 1980-01-06 in days since 0000-03-01


@compiled
def line_end(data: Bytes, start: int) -> int:
    """Return the position of the newline; −1 without one."""
    for k in range(start, data.size):
        if data[k] == _NEWLINE:
            return k
    return -1


@compiled
def text_end(data: Bytes, start: int, end: int) -> int:
    """Return the end without trailing blanks and carriage returns."""
    while end > start and (data[end - 1] == _SPACE or data[end - 1] == _CR):
        end -= 1
    return end


@compiled
def integer(data: Bytes, start: int, end: int) -> int:
    """Return the integer of digits with leading blanks; −1 for anything else."""
    while start < end and data[start] == _SPACE:
        start += 1
    if start == end:
        return -1
    value = 0
    for k in range(start, end):
        digit = int(data[k]) - ZERO
        if digit < 0 or digit > 9:
            return -1
        value = value * 10 + digit
    return value


@compiled
def thousandths(data: Bytes, start: int, end: int) -> int:
    """Return the thousandths of F14.3 at `start` of a line whose text ends at `end`."""
    if end <= start:
        return BLANK
    stop = start + 10
    k = start
    while k < stop and k < end and data[k] == _SPACE:
        k += 1
    if k == end:
        return BLANK
    if end < start + 14:
        return BAD
    if k == stop and data[stop] == _SPACE:
        for j in range(stop, start + 14):
            if data[j] != _SPACE:
                return BAD
        return BLANK
    negative = False
    if k < stop and (data[k] == _MINUS or data[k] == _PLUS):
        negative = data[k] == _MINUS
        k += 1
    if data[stop] != _POINT:
        return BAD
    value = 0
    for j in range(k, stop):
        digit = int(data[j]) - ZERO
        if digit < 0 or digit > 9:
            return BAD
        value = value * 10 + digit
    for j in range(stop + 1, stop + 4):
        digit = int(data[j]) - ZERO
        if digit < 0 or digit > 9:
            return BAD
        value = value * 10 + digit
    return -value if negative else value


@compiled
def indicator(data: Bytes, start: int, end: int) -> int:
    """Return a digit, 0 for a blank; −1 for anything else."""
    if start >= end or data[start] == _SPACE:
        return 0
    digit = int(data[start]) - ZERO
    return digit if 0 <= digit <= 9 else -1


@compiled
def _days(year: int, month: int, day: int) -> int:
    """Return the days since 1980-01-06 of the Gregorian calendar; −1 for an invalid or an earlier day."""
    lengths = (31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31)
    if year < 1980 or year > 2199 or month < 1 or month > 12 or day < 1:
        return -1
    leap = year % 4 == 0 and (year % 100 != 0 or year % 400 == 0)
    if day > lengths[month - 1] + (1 if leap and month == 2 else 0):
        return -1
    # Years from March to February: the leap day is the last, five months have 153 days.
    months = (month + 9) % 12
    y = year - (1 if month <= 2 else 0)
    whole = 365 * y + y // 4 - y // 100 + y // 400 + (153 * months + 2) // 5 + day - 1
    return max(whole - _GPS_EPOCH_DAY, -1)


@compiled
def epoch_time(data: Bytes, start: int, end: int, picoseconds: bool) -> int:
    """Return the time of an epoch line, ns since 1980-01-06 in the file's time system; −1 where it is malformed."""
    year = integer(data, start + 2, start + 6)
    month = integer(data, start + 7, start + 9)
    day = integer(data, start + 10, start + 12)
    hour = integer(data, start + 13, start + 15)
    minute = integer(data, start + 16, start + 18)
    second = integer(data, start + 18, start + 21)
    fraction = integer(data, start + 22, start + 29)
    days = _days(year, month, day)
    if days < 0 or not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < 60 and fraction >= 0):
        return -1
    if data[start + 21] != _POINT or data[start + 22] == _SPACE:
        return -1
    for k in (1, 6, 9, 12, 15, 29, 30):
        if data[start + k] != _SPACE:
            return -1
    time_ns = (((days * 24 + hour) * 60 + minute) * 60 + second) * NS_PER_SECOND + fraction * 100
    if picoseconds and end > start + _PICOSECONDS_OFFSET:
        first = start + _PICOSECONDS_OFFSET
        value_ps = integer(data, first, min(first + 5, end))
        if end != first + 5 or value_ps < 0:
            return -1
        time_ns += (value_ps + 500) // 1000
    return time_ns


@compiled
def satellite_at(data: Bytes, start: int, end: int) -> int:
    """Return system letter × 256 + number; −1 where it is malformed."""
    if end < start + 3:
        return -1
    number = integer(data, start + 1, start + 3)
    return int(data[start]) * 256 + number if number > 0 else -1
