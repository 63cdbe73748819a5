"""Broadcast ephemerides of GLONASS as the integers that it transmits, in RTCM messages and in strings alike.

Source: ICD GLONASS, L1, L2, edition 5.1 (2008), 4.4 (strings 1 to 5, tables 4.5 and 4.6), 4.7 (check bits). Numbers
with a sign are sign and magnitude.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from camber.formats.broadcast.bit_fields import BitField, BitLayout, decode_layout
from camber.formats.broadcast.glonass_time import gps_ns_of_day_number
from camber.formats.observations import GLONASS_CHANNELS, GlonassEphemeris
from camber.geodesy.gps_time import NS_PER_SECOND

_POSITION = BitField(27, 2.0**-11 * 1e3, signed=True)
_VELOCITY = BitField(24, 2.0**-20 * 1e3, signed=True)
_ACCELERATION = BitField(5, 2.0**-30 * 1e3, signed=True)
GLONASS_FIELDS: dict[str, BitField] = {
    **dict.fromkeys(("x_m", "y_m", "z_m"), _POSITION),
    **dict.fromkeys(("vx_m_s", "vy_m_s", "vz_m_s"), _VELOCITY),
    **dict.fromkeys(("ax_m_s2", "ay_m_s2", "az_m_s2"), _ACCELERATION),
    "tau_s": BitField(22, 2.0**-30, signed=True),
    "gamma": BitField(11, 2.0**-40, signed=True),
    "delta_tau_s": BitField(5, 2.0**-30, signed=True),
    "tb": BitField(7, 900.0),
    "tk_hour": BitField(5, 3600.0),
    "tk_minute": BitField(6, 60.0),
    "tk_half": BitField(1, 30.0),
    "day": BitField(11),
    "unhealthy": BitField(1),
    "unhealthy_now": BitField(1),
    "satellite": BitField(5),
}
"""Fields of strings 1 to 4. `unhealthy` is the first bit of B_n, `unhealthy_now` l_n, `day` N_T, `satellite` n."""
STRINGS: dict[int, BitLayout] = {
    1: (2, 2, "tk_hour", "tk_minute", "tk_half", "vx_m_s", "ax_m_s2", "x_m"),
    2: ("unhealthy", 2, 1, "tb", 5, "vy_m_s", "ay_m_s2", "y_m"),
    3: (1, "gamma", 1, 2, "unhealthy_now", "vz_m_s", "az_m_s2", "z_m"),
    4: ("tau_s", "delta_tau_s", 5, 14, 1, 4, 3, "day", "satellite", 2),
}
"""After the number of the string (tables 4.5 and 4.6)."""
_STRING_BITS, _CHECK_BITS, _NUMBER_BITS = 85, 8, 4  # figure 4.1
_BODY_BITS = _STRING_BITS - 1 - _NUMBER_BITS - _CHECK_BITS
_WORDS = 4  # of 32 bits; 85 bits are in the first three
_MAX_TB = 95  # 4.4: quarters of an hour, the last begins at 23:45
_LEAST_RADIUS_M, _GREATEST_RADIUS_M = (
    2.4e7,
    2.7e7,
)  # chosen: orbits have 25,500 km (5.1, 3.3.2), nearly circular


def _check_masks() -> tuple[int, ...]:
    """Return the bits of a string, bit 1 lowest, that each of the sums C_1 to C_7 has with its check bit (4.7).

    It is Hamming's code: data bits 9 to 85 have the numbers that are no powers of two, and check bit k sums up those
    whose number has bit k.
    """
    numbers = [n for n in range(3, 128) if n & (n - 1)][: _STRING_BITS - _CHECK_BITS]
    return tuple(
        1 << k | sum(1 << _CHECK_BITS + bit for bit, number in enumerate(numbers) if number >> k & 1)
        for k in range(_CHECK_BITS - 1)
    )


_MASKS = _check_masks()


def decode_string(words: Sequence[int]) -> tuple[int, dict[str, int]]:
    """Return the number of a string (1 to 15) and the fields in it, unsigned: those of `STRINGS`, else none.

    The string begins at the first bit of four words of 32 bits, as a u-blox receiver reports it. Raises ValueError
    where the check bits, the idle bit or the number of words is wrong: an error in one bit is not corrected.
    """
    if len(words) != _WORDS:
        raise ValueError(f"{len(words)} words, expected {_WORDS}")
    string = (words[0] << 64 | words[1] << 32 | words[2]) >> 96 - _STRING_BITS
    sums = [(string & mask).bit_count() & 1 for mask in _MASKS]
    if any(sums) or string.bit_count() & 1 or string >> _STRING_BITS - 1:
        raise ValueError(f"check bits of string {string:022x} are wrong")
    number = string >> _STRING_BITS - 1 - _NUMBER_BITS
    if number not in STRINGS:
        return number, {}
    body = string >> _CHECK_BITS & (1 << _BODY_BITS) - 1
    return number, decode_layout(body, _BODY_BITS, STRINGS[number], GLONASS_FIELDS)


def glonass_ephemeris_from_integers(
    integers: Mapping[str, int], *, channel: int, near_ns: int
) -> GlonassEphemeris:
    """Return the ephemeris of the unsigned `GLONASS_FIELDS`, its day being the one nearest to `near_ns` (GPS time).

    Raises ValueError for a satellite, a time, a channel or a place that no satellite has.
    """
    values = {name: _value(integers[name], field) for name, field in GLONASS_FIELDS.items()}
    if integers["satellite"] < 1 or not 1 <= integers["tb"] <= _MAX_TB:
        raise ValueError(f"satellite {integers['satellite']}, t_b {integers['tb']}")
    if channel not in GLONASS_CHANNELS:
        raise ValueError(f"frequency channel {channel}")
    radius_m = sum(values[name] ** 2 for name in ("x_m", "y_m", "z_m")) ** 0.5
    if not _LEAST_RADIUS_M < radius_m < _GREATEST_RADIUS_M:
        raise ValueError(f"distance from the earth's centre {radius_m:.0f} m")
    toe_ns = gps_ns_of_day_number(integers["day"], int(values["tb"]) * NS_PER_SECOND, near_ns)
    frame_s = values["tk_hour"] + values["tk_minute"] + values["tk_half"]
    return GlonassEphemeris(
        satellite=ord("R") * 256 + integers["satellite"],
        toe_ns=toe_ns,
        transmission_ns=gps_ns_of_day_number(0, int(frame_s) * NS_PER_SECOND, toe_ns),
        iode=integers["tb"],
        channel=channel,
        position_m=(values["x_m"], values["y_m"], values["z_m"]),
        velocity_m_s=(values["vx_m_s"], values["vy_m_s"], values["vz_m_s"]),
        acceleration_m_s2=(values["ax_m_s2"], values["ay_m_s2"], values["az_m_s2"]),
        clock=(-values["tau_s"], values["gamma"]),
        health=integers["unhealthy"] | integers["unhealthy_now"],
        group_delay_s=values["delta_tau_s"],
    )


def _value(integer: int, field: BitField) -> float:
    if not field.signed:
        return integer * field.resolution
    magnitude = integer & (1 << field.width - 1) - 1
    return (-magnitude if integer >> field.width - 1 else magnitude) * field.resolution
