"""Decoder of a port that carries UBX, SBF, NMEA 0183 and RTCM 3, in any order and with garbage between them."""

from __future__ import annotations

from datetime import date

from camber.formats.nmea.epochs import NmeaDecoder, NmeaResult
from camber.formats.receiver.frame_buffer import Frame, FramedDecoder, FrameProtocol
from camber.formats.receiver.integrity_report import IntegrityReport
from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.receiver.satellite_report import SatelliteReport
from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.rtcm.reader import RtcmDecoder, RtcmResult
from camber.formats.sbf.reader import SbfMessages, SbfResult
from camber.formats.ubx.reader import UbxMessages, UbxResult

MixedResult = UbxResult | SbfResult | NmeaResult | RtcmResult


class MixedDecoder(FramedDecoder[MixedResult]):
    """Passes the messages of each protocol to its decoder; the results are in the stream's order.

    `near_ns` as for `UbxMessages` and `RtcmDecoder`; without it RTCM is decoded as soon as UBX, SBF or NMEA
    contain a date.
    Protocols that are not in `protocols` are skipped like garbage.
    Where UBX or SBF contains positions (NAV-PVT, PVTGeodetic), or UBX satellites (NAV-SAT), those of NMEA would be
    duplicates and are only counted.
    """

    def __init__(
        self,
        source_name: str,
        near_ns: int | None = None,
        *,
        utc_date: date | None = None,
        protocols: tuple[FrameProtocol, ...] = ("ubx", "nmea", "rtcm", "sbf"),
    ) -> None:
        super().__init__(*protocols)
        self.source_name = source_name
        report = IntegrityReport()
        self.ubx = UbxMessages(near_ns, report)
        self.sbf = SbfMessages(report)
        self.nmea = NmeaDecoder(source_name, utc_date=utc_date, report=report)
        self.rtcm = None if near_ns is None else RtcmDecoder(near_ns)
        """None while there is no date."""
        self.rtcm_without_time = 0
        """Messages of RTCM before there was a date."""
        self.positions_not_used = 0
        """Positions of NMEA that UBX or SBF contains too."""
        self.satellites_not_used = 0
        """Reports of satellites of NMEA that UBX contains too."""

    @property
    def bytes_skipped(self) -> int:
        """Bytes that are not part of a frame or sentence, without line ends."""
        return super().bytes_skipped + self.nmea.bytes_skipped

    def _end(self) -> list[MixedResult]:
        results = self._update_time([*self.ubx.finish(), *self.sbf.finish()]) + self._without_duplicates(
            self.nmea.finish()
        )
        return results if self.rtcm is None else [*results, *self.rtcm.finish()]

    def _take(self, frame: Frame) -> list[MixedResult]:
        if frame.protocol == "ubx":
            return self._update_time([*self.ubx.take(frame.data)])
        if frame.protocol == "sbf":
            return self._update_time([*self.sbf.take(frame.data)])
        if frame.protocol == "nmea":
            return self._without_duplicates(self.nmea.take(frame.data, frame.byte_offset))
        if self.rtcm is None:
            self.rtcm_without_time += 1
            return []
        return [*self.rtcm.take(frame.data)]

    def _update_time(self, results: list[UbxResult | SbfResult]) -> list[MixedResult]:
        for result in results:
            if isinstance(result, ReceiverEpoch):
                self._share_time(result.epoch.time_ns)
            elif isinstance(result, ReceiverSolution):
                self._share_time(result.time_ns)
        return [*results]

    def _without_duplicates(self, results: list[NmeaResult]) -> list[MixedResult]:
        kept = list[MixedResult]()
        for result in results:
            if isinstance(result, ReceiverSolution):
                self._share_time(result.time_ns)
                if self.ubx.has_positions or self.sbf.has_positions:
                    self.positions_not_used += 1
                    continue
            if isinstance(result, SatelliteReport) and self.ubx.has_satellites:
                self.satellites_not_used += 1
                continue
            kept.append(result)
        return kept

    def _share_time(self, time_ns: int) -> None:
        """Give the time of one protocol to the decoders without any."""
        self.nmea.set_date_near(time_ns)
        if self.ubx.near_ns is None:
            self.ubx.near_ns = time_ns
        if self.rtcm is None:
            self.rtcm = RtcmDecoder(time_ns)
