"""RTCM 3.3 ephemeris messages: the order of their fields.

Source: RTCM 10403.3, tables 3.5-21 (1019), 3.5-22 (1020), 3.5-70 (1042), 3.5-72 (1044), 3.5-73 (1045), 3.5-74 (1046).
"""

from __future__ import annotations

from camber.formats.broadcast.bit_fields import BitField, BitLayout, bits_to_bytes, pack_bits
from camber.formats.broadcast.ephemeris_fields import FIELDS, integers_from_ephemeris
from camber.formats.broadcast.glonass_strings import GLONASS_FIELDS
from camber.formats.observations import Ephemeris

_ORBIT = """
    crs_m mean_motion_difference_rad_s mean_anomaly_rad cuc eccentricity cus sqrt_a toe_s cic ascending_node_rad cis
    inclination_rad crc_m perigee_rad ascending_node_rate_rad_s
"""
_GALILEO = f"""
    satellite week iode accuracy inclination_rate_rad_s toc_s af2 af1 af0_s {_ORBIT} bgd_e5a_s
"""
_MESSAGES: tuple[tuple[int, str, str, int], ...] = (
    (
        1019,
        "G",
        f"""satellite week accuracy codes_on_l2 inclination_rate_rad_s iode toc_s af2 af1 af0_s iodc {_ORBIT}
        tgd_s health l2_p_data fit""",
        0,
    ),
    (
        1042,
        "C",
        f"""satellite week accuracy inclination_rate_rad_s iode toc_s af2 af1 af0_s aodc {_ORBIT}
        tgd1_s tgd2_s health""",
        0,
    ),
    (
        1044,
        "J",
        f"""satellite toc_s af2 af1 af0_s iode {_ORBIT} inclination_rate_rad_s codes_on_l2 week accuracy health
        tgd_s iodc fit""",
        0,
    ),
    (1045, "E", f"{_GALILEO} e5a_health e5a_invalid", 7),
    (1046, "E", f"{_GALILEO} bgd_e5b_s e5b_health e5b_invalid e1b_health e1b_invalid", 2),
)
EPHEMERIS_MESSAGES = {
    number: (system, tuple(names.split()), reserved_bits)
    for number, system, names, reserved_bits in _MESSAGES
}
"""By message number: the system, its fields in order, and the number of reserved bits after them."""
GLONASS_MESSAGE = 1020  # RTCM 10403.3, table 3.5-22
GLONASS_MESSAGE_FIELDS = {**GLONASS_FIELDS, "satellite": BitField(6), "channel": BitField(5)}
"""As in GLONASS' strings; DF040, `channel`, is the frequency channel plus 7."""
GLONASS_LAYOUT: BitLayout = (
    *("satellite", "channel", 1 + 1 + 2, "tk_hour", "tk_minute", "tk_half", "unhealthy", 1, "tb"),
    *("vx_m_s", "x_m", "ax_m_s2", "vy_m_s", "y_m", "ay_m_s2", "vz_m_s", "z_m", "az_m_s2"),
    *(1, "gamma", 2, "unhealthy_now", "tau_s", "delta_tau_s", 5 + 1 + 4, "day"),
)
"""Message 1020 after its number; what follows is not read."""


def ephemeris_payloads(ephemeris: Ephemeris) -> list[bytes]:
    """Return the messages of an ephemeris, without frames: two for Galileo (F/NAV 1045, I/NAV 1046), else one.

    The week is that of the reference time. Both of Galileo contain the given elements. Raises ValueError as
    `integers_from_ephemeris` does.
    """
    integers = integers_from_ephemeris(ephemeris)
    system = chr(ephemeris.satellite >> 8)
    payloads = []
    for number, (message_system, names, reserved_bits) in EPHEMERIS_MESSAGES.items():
        if message_system == system:
            fields = ((integers[name], FIELDS[system][name].width) for name in names)
            payloads.append(bits_to_bytes(*pack_bits([(number, 12), *fields, (0, reserved_bits)])))
    return payloads
