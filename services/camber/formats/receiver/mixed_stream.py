"""One port that carries UBX, NMEA 0183 and RTCM 3 together, in any order and with garbage between them."""

from __future__ import annotations

from datetime import date

from camber.formats.nmea.epochs import NmeaDecoder, NmeaResult
from camber.formats.receiver.frame_buffer import Frame, FrameBuffer, FrameProtocol
from camber.formats.receiver.integrity_report import IntegrityReport
from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.rtcm.reader import RtcmDecoder, RtcmResult
from camber.formats.ubx.rawx_reader import RawxEpoch
from camber.formats.ubx.reader import UbxMessages, UbxResult

MixedResult = UbxResult | NmeaResult | RtcmResult
_ALL: tuple[FrameProtocol, ...] = ("ubx", "nmea", "rtcm")


class MixedDecoder:
    """Finds the messages of each protocol and hands them to its decoder; the results come in the stream's order.

    They do not depend on how the stream is cut. `near_ns` as for `UbxMessages` and `RtcmDecoder`; where it is not
    given RTCM is read from when UBX or NMEA have said a date. What `protocols` leaves out is skipped like garbage.
    Where UBX gives positions (NAV-PVT), those of NMEA would be the same ones again, and are counted.
    """

    def __init__(
        self,
        source_name: str,
        near_ns: int | None = None,
        *,
        utc_date: date | None = None,
        protocols: tuple[FrameProtocol, ...] = _ALL,
    ) -> None:
        self.source_name = source_name
        statements = IntegrityReport()
        self.ubx = UbxMessages(near_ns, statements)
        self.nmea = NmeaDecoder(source_name, utc_date=utc_date, statements=statements)
        self.rtcm = None if near_ns is None else RtcmDecoder(near_ns)
        """None while there is no date."""
        self.rtcm_without_time = 0
        """Messages of RTCM before there was a date."""
        self.positions_not_used = 0
        """Positions of NMEA beside UBX's."""
        self._frames = FrameBuffer(*protocols)

    @property
    def bytes_skipped(self) -> int:
        """Bytes that belong to no frame or sentence, line ends apart."""
        return self._frames.bytes_skipped + self.nmea.bytes_skipped

    @property
    def failed_checks(self) -> int:
        """Things that began like a frame of UBX or RTCM and had a wrong checksum."""
        return sum(self._frames.failed_checks.values())

    def feed(self, data: bytes) -> list[MixedResult]:
        """What the bytes complete. Never raises; keeps one partial frame, and one epoch of each protocol at most."""
        return [result for frame in self._frames.feed(data) for result in self._take(frame)]

    def finish(self) -> list[MixedResult]:
        """Call at the end of the stream, or when it has fallen silent: what is left."""
        results = [result for frame in self._frames.finish() for result in self._take(frame)]
        results += self._timed(self.ubx.finish())
        results += self._sifted(self.nmea.finish())
        return results if self.rtcm is None else [*results, *self.rtcm.finish()]

    def _take(self, frame: Frame) -> list[MixedResult]:
        if frame.protocol == "ubx":
            return self._timed(self.ubx.take(frame.data))
        if frame.protocol == "nmea":
            return self._sifted(self.nmea.take(frame.data, frame.byte_offset))
        if self.rtcm is None:
            self.rtcm_without_time += 1
            return []
        return [*self.rtcm.take(frame.data)]

    def _timed(self, results: list[UbxResult]) -> list[MixedResult]:
        for result in results:
            if isinstance(result, RawxEpoch):
                self._time_is(result.epoch.time_ns)
            elif isinstance(result, ReceiverSolution):
                self._time_is(result.time_ns)
        return [*results]

    def _sifted(self, results: list[NmeaResult]) -> list[MixedResult]:
        sifted = list[MixedResult]()
        for result in results:
            if isinstance(result, ReceiverSolution):
                self._time_is(result.time_ns)
                if self.ubx.has_positions:
                    self.positions_not_used += 1
                    continue
            sifted.append(result)
        return sifted

    def _time_is(self, time_ns: int) -> None:
        """Said by one protocol, for those that have not heard of a time yet."""
        self.nmea.date_near(time_ns)
        if self.ubx.near_ns is None:
            self.ubx.near_ns = time_ns
        if self.rtcm is None:
            self.rtcm = RtcmDecoder(time_ns)
