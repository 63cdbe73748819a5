"""A recording of satellite navigation of any format that Camber reads, found by its content and read piece by piece.

RINEX 2, 3 and 4 (observations, navigation), solutions of RTKLIB, and streams of UBX, SBF, RTCM 3 and NMEA, alone or
together; each may be packed as in `rinex_files`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Literal

from camber.formats.broadcast.ephemeris_fields import FIELDS, GNSS_TIME_SCALES
from camber.formats.errors import FormatError
from camber.formats.nmea.sentences import Sentence, parse_sentence
from camber.formats.receiver.frame_buffer import Frame, FrameBuffer
from camber.formats.receiver.mixed_stream import MixedDecoder, MixedResult
from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.rinex.compressed_files import rinex_chunks
from camber.formats.rinex.navigation_reader import NavigationDecoder, NavigationResult
from camber.formats.rinex.observation_reader import ObservationResult, RinexDecoder
from camber.formats.rtcm.ephemeris_messages import EPHEMERIS_MESSAGES
from camber.formats.sbf.reader import block_number
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from camber.schemas.gnss import ReceiverIntegrity

Item = ObservationResult | NavigationResult | MixedResult
Format = Literal["RINEX observations", "RINEX navigation", "RTKLIB solutions", "receiver stream"]
WeekFrom = Literal["recording", "ephemerides", "caller", "file date"]
"""What settles the week where the recording does not: the last is a guess."""

_EXPECTED = "RINEX 2, 3 or 4, UBX, SBF, RTCM 3, NMEA or a solution file of RTKLIB"
_UNIX_TIME_OF_GPS_EPOCH_S = 315_964_800  # 1980-01-06 00:00 UTC (IS-GPS-200)
UBX_NAMES = {
    0x0101: "NAV-POSECEF", 0x0102: "NAV-POSLLH", 0x0103: "NAV-STATUS", 0x0104: "NAV-DOP", 0x0105: "NAV-ATT",
    0x0106: "NAV-SOL", 0x0107: "NAV-PVT", 0x0109: "NAV-ODO", 0x0111: "NAV-VELECEF", 0x0112: "NAV-VELNED",
    0x0113: "NAV-HPPOSECEF", 0x0114: "NAV-HPPOSLLH", 0x0120: "NAV-TIMEGPS", 0x0121: "NAV-TIMEUTC",
    0x0122: "NAV-CLOCK", 0x0123: "NAV-TIMEGLO", 0x0124: "NAV-TIMEBDS", 0x0125: "NAV-TIMEGAL",
    0x0126: "NAV-TIMELS", 0x0127: "NAV-TIMEQZSS", 0x0130: "NAV-SVINFO", 0x0132: "NAV-SBAS", 0x0134: "NAV-ORB",
    0x0135: "NAV-SAT", 0x0136: "NAV-COV", 0x0139: "NAV-GEOFENCE", 0x013B: "NAV-SVIN", 0x013C: "NAV-RELPOSNED",
    0x0142: "NAV-SLAS", 0x0143: "NAV-SIG", 0x0160: "NAV-AOPSTATUS", 0x0161: "NAV-EOE", 0x0162: "NAV-PL",
    0x0213: "RXM-SFRBX", 0x0214: "RXM-MEASX", 0x0215: "RXM-RAWX", 0x0232: "RXM-RTCM", 0x0500: "ACK-NAK",
    0x0501: "ACK-ACK", 0x068A: "CFG-VALSET", 0x068B: "CFG-VALGET", 0x0A04: "MON-VER", 0x0A09: "MON-HW",
    0x0A36: "MON-COMMS", 0x0A38: "MON-RF", 0x0D03: "TIM-TM2", 0x1002: "ESF-MEAS", 0x1010: "ESF-STATUS",
    0x2709: "SEC-SIG",
}  # fmt: skip
SBF_NAMES = {
    4001: "DOP", 4002: "GALNav", 4004: "GLONav", 4005: "GLOAlm", 4006: "PVTCartesian", 4007: "PVTGeodetic",
    4013: "ChannelStatus", 4012: "SatVisibility", 4014: "ReceiverStatus", 4015: "Commands", 4017: "GPSRawCA",
    4022: "GALRawFNAV", 4023: "GALRawINAV", 4026: "GLORawCA", 4027: "MeasEpoch", 4028: "BaseVectorGeod",
    4030: "GALIon", 4031: "GALUtc", 4043: "BaseVectorCart", 4047: "BDSRaw", 4059: "DiskStatus", 4081: "BDSNav",
    4082: "QualityInd", 4092: "RFStatus", 4095: "QZSNav", 4097: "EncapsulatedOutput", 4109: "Meas3Ranges",
    4120: "BDSIon", 4245: "GALAuthStatus", 5891: "GPSNav", 5893: "GPSIon", 5894: "GPSUtc", 5902: "ReceiverSetup",
    5905: "PosCovCartesian", 5906: "PosCovGeodetic", 5907: "VelCovCartesian", 5908: "VelCovGeodetic",
    5914: "ReceiverTime", 5921: "EndOfPVT", 5922: "EndOfMeas", 5938: "AttEuler", 5939: "AttCovEuler",
}  # fmt: skip


class RecordingFile:
    """One file: `items()` reads it, once; `decoder` counts what it leaves out.

    Raises FormatError where the content is of no known format, OSError where it cannot be opened. `near_ns` (GPS time)
    is near the recording, for protocols that do not say the week.
    """

    def __init__(self, path: Path, near_ns: int | None = None, *, count_messages: bool = False) -> None:
        self.path = path
        self.week_from: WeekFrom = "recording" if near_ns is None else "caller"
        self.messages: Counter[str] = Counter()
        """Of a stream, by protocol and kind, where they are to be counted."""
        self.damage: FormatError | None = None
        """Of the compression: the recording ends there."""
        pieces = rinex_chunks(path)
        first = next(pieces, b"")
        self._pieces = chain((first,), pieces)
        self.format, self.decoder = self._recognised(first, near_ns)
        self._counted: FrameBuffer | None = None
        if count_messages and self.format == "receiver stream":
            self._counted = FrameBuffer("ubx", "sbf", "nmea", "rtcm")

    def items(self) -> Iterator[list[Item]]:
        """What the file holds, in its order, as much at a time as a piece of it gives."""
        try:
            for piece in self._pieces:
                if self._counted is not None:
                    self._count(self._counted.feed(piece))
                yield [*self.decoder.feed(piece)]
        except FormatError as damage:
            self.damage = damage
        if self._counted is not None:
            self._count(self._counted.finish())
        yield [*self.decoder.finish()]

    def _count(self, frames: list[Frame]) -> None:
        self.messages.update(message_name(frame) for frame in frames if _is_whole(frame))

    def _recognised(
        self, first: bytes, near_ns: int | None
    ) -> tuple[Format, RinexDecoder | NavigationDecoder | PosDecoder | MixedDecoder]:
        name = self.path.name
        if first[60:80].startswith(b"RINEX VERSION"):
            if first[20:21] == b"N":
                return "RINEX navigation", NavigationDecoder(name)
            return "RINEX observations", RinexDecoder(name)
        if first.startswith(b"%"):
            return "RTKLIB solutions", PosDecoder(name)
        buffer = FrameBuffer("ubx", "sbf", "nmea", "rtcm")
        frames = [frame for frame in (*buffer.feed(first), *buffer.finish()) if _is_whole(frame)]
        if not first:
            raise FormatError(name, "empty file", _EXPECTED)
        if not frames:
            raise FormatError(name, "content", _EXPECTED, actual=first[:20])
        if near_ns is None:
            near_ns = self._week(first, frames)
        return "receiver stream", MixedDecoder(name, near_ns)

    def _week(self, first: bytes, frames: list[Frame]) -> int | None:
        """A time within half a week of the RTCM in a stream, which does not say its own; None: there is no telling."""
        rtcm = [frame for frame in frames if frame.protocol == "rtcm"]
        if not rtcm:
            return None
        others = MixedDecoder(self.path.name, protocols=("ubx", "sbf", "nmea"))
        for item in (*others.feed(first), *others.finish()):
            if isinstance(item, ReceiverEpoch):
                return item.epoch.time_ns
            if isinstance(item, ReceiverSolution | ReceiverIntegrity):
                return item.time_ns
        # Of weeks that have rolled over those nearest to the file's date are meant.
        file_ns = max(round(self.path.stat().st_mtime) - _UNIX_TIME_OF_GPS_EPOCH_S, 0) * NS_PER_SECOND
        for frame in rtcm:
            time_ns = _reference_time_ns(frame.data[3:-3], file_ns)
            if time_ns is not None:
                self.week_from = "ephemerides"
                return time_ns
        if len(rtcm) < len(frames):
            return None
        self.week_from = "file date"
        return file_ns


def _is_whole(frame: Frame) -> bool:
    """Return whether the frame is valid; a NMEA candidate may fail its parser."""
    return frame.protocol != "nmea" or isinstance(parse_sentence("", frame.data, 0), Sentence)


def message_name(frame: Frame) -> str:
    """Such as `UBX RXM-RAWX`, `SBF MeasEpoch`, `RTCM 1077`, `NMEA GNGGA`."""
    data = frame.data
    if frame.protocol == "rtcm":
        return f"RTCM {data[3] << 4 | data[4] >> 4}" if len(data) >= 8 else "RTCM, empty"
    if frame.protocol == "sbf":
        number = block_number(data)
        return f"SBF {SBF_NAMES.get(number, number)}"
    if frame.protocol == "ubx":
        kind = data[2] << 8 | data[3]
        return f"UBX {UBX_NAMES.get(kind, f'{data[2]:02X}-{data[3]:02X}')}"
    return f"NMEA {data[1:].split(b',', 1)[0].split(b'*', 1)[0][:10].decode('latin-1')}"


def _reference_time_ns(payload: bytes, near_ns: int) -> int | None:
    """Of a message with an ephemeris: its toe, whose week is the one nearest to `near_ns` of those it may mean."""
    number = payload[0] << 4 | payload[1] >> 4 if len(payload) >= 2 else 0
    if number not in EPHEMERIS_MESSAGES:
        return None
    system, layout, _ = EPHEMERIS_MESSAGES[number]
    scale, fields, place = GNSS_TIME_SCALES[system], dict[str, int](), 12
    bits, width = int.from_bytes(payload, "big"), 8 * len(payload)
    for name in layout:
        place += FIELDS[system][name].width
        if place > width:
            return None
        fields[name] = bits >> (width - place) & (1 << FIELDS[system][name].width) - 1
    of_week_ns = int(fields["toe_s"] * FIELDS[system]["toe_s"].resolution) * NS_PER_SECOND
    turn_ns = scale.weeks * NS_PER_WEEK
    first_ns = (scale.first_gps_week + fields["week"]) * NS_PER_WEEK + of_week_ns + scale.gps_offset_ns
    return first_ns + round((near_ns - first_ns) / turn_ns) * turn_ns
