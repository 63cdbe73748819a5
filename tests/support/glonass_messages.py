"""GLONASS' strings, RTCM 1020 and RINEX records written: the readers' oracle, by the bit numbers of the documents.

ICD GLONASS 5.1, tables 4.5, 4.6 and 4.13; RTCM 10403.3, message 1020; RINEX 2.11, table A11, and 3.04, table A10.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from camber.formats.observations import GlonassEphemeris
from camber.formats.rtcm.writer import rtcm_frame
from camber.formats.ubx.writer import ubx_frame
from camber.geodesy.gps_time import NS_PER_DAY, NS_PER_SECOND, CalendarTime, gps_ns_from_utc, utc_from_gps_ns
from support.rinex2_writer import labelled

NS_PER_HOUR = 3600 * NS_PER_SECOND
X_STEP_M, V_STEP_M_S, A_STEP_M_S2 = 1000.0 / 2**11, 1000.0 / 2**20, 1000.0 / 2**30
CHECKS: tuple[tuple[tuple[int, int], ...], ...] = (
    (
        *((9, 10), (12, 13), (15, 15), (17, 17), (19, 20), (22, 22), (24, 24), (26, 26), (28, 28), (30, 30)),
        *(
            (32, 32),
            (34, 35),
            *((n, n) for n in range(37, 65, 2)),
            (65, 66),
            *((n, n) for n in range(68, 86, 2)),
        ),
    ),
    (
        *((9, 9), (11, 12), (14, 15), (18, 19), (21, 22), (25, 26), (29, 30), (33, 34), (36, 37), (40, 41)),
        *((44, 45), (48, 49), (52, 53), (56, 57), (60, 61), (64, 65), (67, 68), (71, 72), (75, 76)),
        *((79, 80), (83, 84)),
    ),
    (
        *((10, 12), (16, 19), (23, 26), (31, 34), (38, 41), (46, 49), (54, 57), (62, 65), (69, 72)),
        *((77, 80), (85, 85)),
    ),
    ((13, 19), (27, 34), (42, 49), (58, 65), (73, 80)),
    ((20, 34), (50, 65), (81, 85)),
    ((35, 65),),
    ((66, 85),),
)
"""Table 4.13: the data bits of the check bits 1 to 7."""


def random_glonass_ephemeris(rng: np.random.Generator, number: int, near_ns: int) -> GlonassEphemeris:
    """An ephemeris whose numbers are those that a satellite can send, within hours of a GPS time."""
    utc = utc_from_gps_ns(near_ns)
    quarter = int(rng.integers(1, 96))
    day_ns = gps_ns_from_utc(CalendarTime(utc.year, utc.month, utc.day, 0, 0, 0)) - 3 * NS_PER_HOUR
    toe_ns = day_ns + quarter * 900 * NS_PER_SECOND
    direction = rng.normal(size=3)
    place = np.rint(2.55e7 * direction / np.linalg.norm(direction) / X_STEP_M) * X_STEP_M
    x, y, z = place.tolist()
    vx, vy, vz = (np.rint(rng.uniform(-3500, 3500, 3) / V_STEP_M_S) * V_STEP_M_S).tolist()
    ax, ay, az = (rng.integers(-15, 16, 3) * A_STEP_M_S2).tolist()
    return GlonassEphemeris(
        satellite=ord("R") * 256 + number,
        toe_ns=toe_ns,
        transmission_ns=toe_ns + int(rng.integers(-30, 30)) * 30 * NS_PER_SECOND,
        iode=quarter,
        channel=int(rng.integers(-7, 7)),
        position_m=(x, y, z),
        velocity_m_s=(vx, vy, vz),
        acceleration_m_s2=(ax, ay, az),
        clock=(int(rng.integers(-(2**21), 2**21)) / 2**30, int(rng.integers(-1023, 1024)) / 2**40),
        health=int(rng.random() < 0.1),
        group_delay_s=int(rng.integers(-15, 16)) / 2**30,
    )


def _signed(value: float, step: float, width: int) -> int:
    """Sign and magnitude."""
    return (1 << width - 1 if value < 0.0 else 0) | round(abs(value) / step)


def _frame_time(e: GlonassEphemeris) -> tuple[int, int, int]:
    utc = utc_from_gps_ns(e.transmission_ns + 3 * NS_PER_HOUR)
    return utc.hour, utc.minute, utc.second // 30


def day_number(e: GlonassEphemeris) -> int:
    """N_T of t_b."""
    utc = utc_from_gps_ns(e.toe_ns + 3 * NS_PER_HOUR)
    first = gps_ns_from_utc(CalendarTime(utc.year // 4 * 4, 1, 1, 0, 0, 0))
    midnight = gps_ns_from_utc(CalendarTime(utc.year, utc.month, utc.day, 0, 0, 0))
    return round((midnight - first) / NS_PER_DAY) + 1


def string_words(number: int, fields: dict[int, tuple[int, int]]) -> tuple[int, ...]:
    """Four words of a string: by the number of a field's highest bit its value and width."""
    string = number << 80
    for highest, (value, width) in fields.items():
        assert 0 <= value < 1 << width
        string |= value << highest - width
    for k, spans in enumerate(CHECKS):
        bits = [bit for first, last in spans for bit in range(first, last + 1)]
        string |= (sum(string >> bit - 1 & 1 for bit in bits) & 1) << k
    string |= (string.bit_count() & 1) << 7
    left = string << 96 - 85
    return left >> 64, left >> 32 & 0xFFFFFFFF, left & 0xFFFFFFFF, 0x00010001


def glonass_strings(e: GlonassEphemeris, day: int | None = None) -> list[tuple[int, ...]]:
    """Strings 1 to 5."""
    (x, y, z), (vx, vy, vz), (ax, ay, az) = e.position_m, e.velocity_m_s, e.acceleration_m_s2
    hour, minute, half = _frame_time(e)

    def axis(position: float, velocity: float, acceleration: float) -> dict[int, tuple[int, int]]:
        return {
            64: (_signed(velocity, V_STEP_M_S, 24), 24),
            40: (_signed(acceleration, A_STEP_M_S2, 5), 5),
            35: (_signed(position, X_STEP_M, 27), 27),
        }

    tau, delay = _signed(-e.clock[0], 2.0**-30, 22), _signed(e.group_delay_s, 2.0**-30, 5)
    numbers = {26: (day_number(e) if day is None else day, 11), 15: (e.satellite & 255, 5)}
    return [
        string_words(1, {78: (1, 2), 76: (hour << 7 | minute << 1 | half, 12), **axis(x, vx, ax)}),
        string_words(2, {80: (e.health << 2, 3), 77: (1, 1), 76: (e.iode, 7), **axis(y, vy, ay)}),
        string_words(3, {80: (1, 1), 79: (_signed(e.clock[1], 2.0**-40, 11), 11), **axis(z, vz, az)}),
        string_words(4, {80: (tau, 22), 58: (delay, 5), 53: (3, 5), 33: (5, 4), **numbers, 10: (1, 2)}),
        string_words(5, {80: (77, 11), 36: (8, 5)}),
    ]


def string_message(words: Sequence[int], e: GlonassEphemeris, number: int | None = None) -> bytes:
    """The frame of RXM-SFRBX with a string, of the satellite or the one of another number."""
    head = (6, e.satellite & 255 if number is None else number, 0, e.channel + 7, len(words), 0, 2, 0)
    return ubx_frame(0x02, 0x13, struct.pack(f"<8B{len(words)}I", *head, *words))


def message_1020(e: GlonassEphemeris) -> bytes:
    """The frame of message 1020."""
    hour, minute, half = _frame_time(e)
    pairs = [(1020, 12), (e.satellite & 255, 6), (e.channel + 7, 5), (1, 1), (1, 1), (1, 2)]
    pairs += [(hour, 5), (minute, 6), (half, 1), (e.health, 1), (1, 1), (e.iode, 7)]
    for position, velocity, acceleration in zip(
        e.position_m, e.velocity_m_s, e.acceleration_m_s2, strict=True
    ):
        pairs += [(_signed(velocity, V_STEP_M_S, 24), 24), (_signed(position, X_STEP_M, 27), 27)]
        pairs += [(_signed(acceleration, A_STEP_M_S2, 5), 5)]
    pairs += [(1, 1), (_signed(e.clock[1], 2.0**-40, 11), 11), (3, 2), (0, 1)]
    pairs += [(_signed(-e.clock[0], 2.0**-30, 22), 22), (_signed(e.group_delay_s, 2.0**-30, 5), 5)]
    pairs += [(3, 5), (1, 1), (5, 4), (day_number(e), 11), (1, 2), (0, 1), (0, 11), (0, 32), (0, 5), (0, 22)]
    bits = "".join(f"{value:0{width}b}" for value, width in [*pairs, (0, 1), (0, 7)])
    return rtcm_frame(int(bits, 2).to_bytes(len(bits) // 8, "big"))


def glonass_navigation_text(ephemerides: Sequence[GlonassEphemeris], version: float) -> str:
    """A navigation file of GLONASS alone, of RINEX 2.11 or 3.04, or 3.05 with the delay of L2."""
    file_type = "G: GLONASS NAV DATA" if version < 3.0 else f"{'N: GNSS NAV DATA':<20}R: GLONASS"
    head = labelled(f"{version:9.2f}{'':11}{file_type:<40}", "RINEX VERSION / TYPE")
    return head + labelled("", "END OF HEADER") + "".join(_record(e, version) for e in ephemerides)


def _record(e: GlonassEphemeris, version: float) -> str:
    utc, sent = utc_from_gps_ns(e.toe_ns), utc_from_gps_ns(e.transmission_ns)
    sent_s = float(sent.hour * 3600 + sent.minute * 60 + sent.second)
    number = e.satellite & 255
    if version < 3.0:
        date = (
            f"{utc.year % 100:02d} {utc.month:2d} {utc.day:2d} {utc.hour:2d} {utc.minute:2d}{utc.second:5.1f}"
        )
        head, indent = f"{number:2d} {date}", "   "
    else:
        date = f"{utc.year:4d} {utc.month:02d} {utc.day:02d} {utc.hour:02d} {utc.minute:02d} {utc.second:02d}"
        head, indent = f"R{number:02d} {date}", "    "
    last = (float(e.health), float(e.channel), 0.0)
    rows = [(*e.clock, sent_s)]
    columns = zip(e.position_m, e.velocity_m_s, e.acceleration_m_s2, strict=True)
    rows += [(*(v / 1000.0 for v in row), more) for row, more in zip(columns, last, strict=True)]
    if version >= 3.05:
        rows.append((0.0, e.group_delay_s, 2.0, 0.0))
    lines = ["".join(f"{value:19.12E}".replace("E", "D") for value in row) for row in rows]
    return "".join(f"{start}{text}\n" for start, text in zip((head, *[indent] * 4), lines, strict=False))
