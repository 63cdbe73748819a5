"""RTCM 3.3 messages in their frames: base station, observations (MSM7), broadcast ephemerides.

Source: RTCM 10403.3, 4.2 (frame), 3.5.3 (1005, 1006), 3.5.16 (MSM), 3.5.8, 3.5.15 (ephemerides).
"""

from __future__ import annotations

from camber.formats.broadcast.bit_fields import bits_to_bytes, crc24q, pack_bits, quantize
from camber.formats.observations import Ephemeris, ObservationEpoch
from camber.formats.rtcm.ephemeris_messages import ephemeris_payloads
from camber.formats.rtcm.msm_writer import msm7_payloads

# RTCM 10403.3, 4.2
PREAMBLE = 0xD3
_MAX_PAYLOAD_BYTES = 1023


def rtcm_frame(payload: bytes) -> bytes:
    """Return preamble, length in 10 bits, payload, CRC-24Q; ValueError for a payload above 1023 bytes."""
    if len(payload) > _MAX_PAYLOAD_BYTES:
        raise ValueError(f"payload of {len(payload)} bytes, expected at most {_MAX_PAYLOAD_BYTES}")
    framed = bytes((PREAMBLE, len(payload) >> 8, len(payload) & 255)) + payload
    return framed + crc24q(framed).to_bytes(3, "big")


def format_reference_station(
    position_ecef_m: tuple[float, float, float],
    *,
    station_id: int,
    antenna_height_m: float | None = None,
    systems: str = "GE",
    single_oscillator: bool = True,
) -> bytes:
    """Encode message 1005, or 1006 when an antenna height is given: the antenna reference point, to 0.1 mm.

    `systems` are those served, of `G` (DF022), `R` (DF023), `E` (DF024); the others have no bit. `antenna_height_m` is
    that of the reference point above the marker (DF028). ValueError where a coordinate does not fit.
    """
    if not 0 <= station_id < 4096:
        raise ValueError(f"station id is {station_id}, expected 0 to 4095 (DF003)")
    x, y, z = (
        quantize(f"reference station {axis} [m]", value, 1e-4, 38, signed=True)
        for axis, value in zip("xyz", position_ecef_m, strict=True)
    )
    fields = [
        (1005 if antenna_height_m is None else 1006, 12),
        (station_id, 12),
        (0, 6),  # DF021: ITRF realization year
        *((int(system in systems), 1) for system in "GRE"),
        (0, 1),  # DF141: a real, physical station
        (x, 38),
        (int(single_oscillator), 1),
        (0, 1),
        (y, 38),
        (0, 2),  # DF364: quarter-cycle correction unspecified
        (z, 38),
    ]
    if antenna_height_m is not None:
        fields.append((quantize("antenna height [m]", antenna_height_m, 1e-4, 16, signed=False), 16))
    return rtcm_frame(bits_to_bytes(*pack_bits(fields)))


def format_observations(
    epoch: ObservationEpoch, *, station_id: int, more_follow: bool = False
) -> list[bytes]:
    """Encode the MSM7 messages of one epoch, in their frames; see `msm7_payloads` for what raises ValueError."""
    payloads = msm7_payloads(epoch, station_id=station_id, more_follow=more_follow)
    return [rtcm_frame(payload) for payload in payloads]


def format_ephemeris(ephemeris: Ephemeris) -> list[bytes]:
    """Encode 1019 (GPS), 1042 (BeiDou), 1044 (QZSS), or 1045 and 1046 (Galileo), in frames."""
    return [rtcm_frame(payload) for payload in ephemeris_payloads(ephemeris)]
