"""Broadcast ephemerides as RTCM 3.3 messages: which fields stand where.

Source: RTCM 10403.3, tables 3.5-21 (1019), 3.5-70 (1042), 3.5-72 (1044), 3.5-73 (1045), 3.5-74 (1046).
"""

from __future__ import annotations

from camber.formats.broadcast.bit_fields import bits_to_bytes, joined
from camber.formats.broadcast.ephemeris_fields import FIELDS, ColumnLayout, integers_from_ephemeris
from camber.formats.observations import Ephemeris

_HARMONICS_AND_ANGLES: ColumnLayout = (
    "crs_m",
    "mean_motion_difference_rad_s",
    "mean_anomaly_rad",
    "cuc",
    "eccentricity",
    "cus",
    "sqrt_a",
    "toe_s",
    "cic",
    "ascending_node_rad",
    "cis",
    "inclination_rad",
    "crc_m",
    "perigee_rad",
    "ascending_node_rate_rad_s",
)
_GALILEO: ColumnLayout = (
    "satellite",
    "week",
    "iode",
    "accuracy",
    "inclination_rate_rad_s",
    "toc_s",
    "af2",
    "af1",
    "af0_s",
    *_HARMONICS_AND_ANGLES,
    "bgd_e5a_s",
)
EPHEMERIS_MESSAGES: dict[int, tuple[str, ColumnLayout, int]] = {
    1019: (
        "G",
        (
            "satellite",
            "week",
            "accuracy",
            "codes_on_l2",
            "inclination_rate_rad_s",
            "iode",
            "toc_s",
            "af2",
            "af1",
            "af0_s",
            "iodc",
            *_HARMONICS_AND_ANGLES,
            "tgd_s",
            "health",
            "l2_p_data",
            "fit",
        ),
        0,
    ),
    1042: (
        "C",
        (
            "satellite",
            "week",
            "accuracy",
            "inclination_rate_rad_s",
            "iode",
            "toc_s",
            "af2",
            "af1",
            "af0_s",
            "aodc",
            *_HARMONICS_AND_ANGLES,
            "tgd1_s",
            "tgd2_s",
            "health",
        ),
        0,
    ),
    1044: (
        "J",
        (
            "satellite",
            "toc_s",
            "af2",
            "af1",
            "af0_s",
            "iode",
            *_HARMONICS_AND_ANGLES,
            "inclination_rate_rad_s",
            "codes_on_l2",
            "week",
            "accuracy",
            "health",
            "tgd_s",
            "iodc",
            "fit",
        ),
        0,
    ),
    1045: ("E", (*_GALILEO, "e5a_health", "e5a_invalid"), 7),
    1046: (
        "E",
        (*_GALILEO, "bgd_e5b_s", "e5b_health", "e5b_invalid", "e1b_health", "e1b_invalid"),
        2,
    ),
}
"""By message number: the system, its fields in order, and how many reserved bits follow."""


def ephemeris_payloads(ephemeris: Ephemeris) -> list[bytes]:
    """The messages of an ephemeris, without frames: two of Galileo (F/NAV 1045, I/NAV 1046), else one.

    The week is that of the reference time. For Galileo both come from the one set of elements given. Raises ValueError
    as `integers_from_ephemeris` does.
    """
    integers = integers_from_ephemeris(ephemeris)
    system = chr(ephemeris.satellite >> 8)
    return [
        bits_to_bytes(
            *joined(
                [(number, 12), *((integers[name], FIELDS[system][name].width) for name in layout), (0, spare)]
            )
        )
        for number, (of_system, layout, spare) in EPHEMERIS_MESSAGES.items()
        if of_system == system
    ]
