"""RFStatus and GALAuthStatus: interference, misleading signals and authentication of navigation messages (OSNMA).

Source: Septentrio mosaic-X5 reference guide, the two blocks; modes, flags and masks as the maker's driver for ROS reads
them (septentrio_gnss_driver, message_handler.cpp).
"""

from __future__ import annotations

import struct

from camber.formats.receiver.solution import Fields
from camber.formats.sbf.signal_numbers import SIGNALS

_RF_HEADER = struct.Struct("<6xBBB3x")
_BAND = struct.Struct("<IHB")
_MISLEADING, _INAUTHENTIC = 1 << 0, 1 << 1  # `Flags`
_MITIGATED, _NOT_MITIGATED = 2, 8  # `Mode` of a band; 1 is a filter that the user has set
_AUTHENTICATION = struct.Struct("<6xHfQQQQ")
_AUTHENTICATING = 6  # `Status`
_GALILEO_SIGNALS = sum(1 << number for number in SIGNALS["E"])


def read_radio_state(body: bytes) -> Fields:
    """Decode RFStatus to fields of `ReceiverIntegrity`; ValueError or struct.error where it is malformed.

    Interference is a warning where the receiver mitigates it, critical where it does not. Spoofing is indicated where
    signals are inconsistent, affirmed where their navigation messages fail authentication.
    """
    count, size, flags = _RF_HEADER.unpack_from(body)
    if (count and size < _BAND.size) or len(body) < _RF_HEADER.size + count * size:
        raise ValueError(f"RFStatus of {len(body)} bytes with {count} bands of {size}")
    bands = (_BAND.unpack_from(body, _RF_HEADER.size + k * size) for k in range(count))
    modes = {info & 0b1111 for _, _, info in bands}
    jamming = "critical" if _NOT_MITIGATED in modes else "warning" if _MITIGATED in modes else "none"
    spoofing = "affirmed" if flags & _INAUTHENTIC else "indicated" if flags & _MISLEADING else "none"
    return {"jamming": jamming, "spoofing": spoofing}


def read_authentication(body: bytes, signals_used: int | None) -> Fields:
    """Decode GALAuthStatus to fields of `ReceiverIntegrity`; struct.error where it is malformed.

    `signals_used`: bits by signal number of the last position; None: not known. A fix is authenticated where all
    satellites under authentication pass and it rests on Galileo alone; it is not where one of them fails.
    """
    status, _, galileo_active, galileo_passed, gps_active, gps_passed = _AUTHENTICATION.unpack_from(body)
    if status & 0b111 != _AUTHENTICATING or not galileo_active | gps_active:
        return {"authenticated": "unknown"}
    if galileo_active & ~galileo_passed or gps_active & ~gps_passed:
        return {"authenticated": "no"}
    only_galileo = bool(signals_used) and not (signals_used or 0) & ~_GALILEO_SIGNALS
    return {"authenticated": "yes" if only_galileo and galileo_active else "unknown"}
