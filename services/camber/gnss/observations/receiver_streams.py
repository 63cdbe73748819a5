"""Decoding of one stream, whatever its protocol: observations, ephemerides, positions, statements of integrity."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from typing import Literal

import numpy as np

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.errors import FormatError
from camber.formats.line_buffer import LineBuffer
from camber.formats.nmea.epochs import NmeaDecoder
from camber.formats.observations import BroadcastEphemeris, ObservationEpoch
from camber.formats.receiver.mixed_stream import MixedDecoder
from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.satellite_report import SatelliteReport
from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.rinex.navigation_reader import NavigationDecoder, NavigationResult
from camber.formats.rinex.observation_reader import RinexDecoder
from camber.formats.rtcm.reader import BaseStationEpoch, ReferenceStation, RtcmDecoder
from camber.formats.sbf.reader import SbfDecoder
from camber.formats.ubx.reader import UbxDecoder
from camber.gnss.observations.satellite_states import enu_from_ecef_rotation, geodetic
from camber.schemas.gnss import ReceiverIntegrity

Stream = Literal["rover", "base", "ephemerides"]
StreamProtocol = Literal["pos", "nmea", "ubx", "sbf", "rtcm", "mixed", "rinex"]
_FIRST_LABEL = b"RINEX VERSION / TYPE"


@dataclass(frozen=True, slots=True, kw_only=True)
class StationPosition:
    """An antenna's reference point, ECEF, and the station's label, as its stream states them.

    `is_virtual`: of a station that a network computes for the vehicle.
    """

    position_ecef_m: tuple[float, float, float]
    label: str = "unnamed"
    is_virtual: bool = False


DecodedItem = (
    ObservationEpoch
    | BroadcastEphemeris
    | IonosphereCoefficients
    | StationPosition
    | ReceiverSolution
    | ReceiverIntegrity
    | SatelliteReport
    | FormatError
)
"""Content of any stream; the rest (baselines, for example) is dropped."""
StreamItem = tuple[Stream, DecodedItem]
"""An item and the stream to which it belongs."""
_FRAMING = ("bytes_skipped", "failed_checks", "rows_refused", "rtcm_without_time")
_CONTENT = ("malformed", "incomplete", "bad_subframes", "repeated_signals", "without_time")


class NavigationFiles:
    """RINEX navigation files concatenated on one stream; the decoder itself handles one.

    A line with a RINEX version ends the file before and begins the next.
    """

    def __init__(self, source_name: str) -> None:
        self._source_name = source_name
        self._lines = LineBuffer()
        self._file: NavigationDecoder | None = None

    def feed(self, data: bytes) -> list[NavigationResult | IonosphereCoefficients]:
        """Results that the bytes complete; the last record of a file waits for the next file, or for `end`."""
        results: list[NavigationResult | IonosphereCoefficients] = []
        for _, line in self._lines.feed(data):
            text = b"" if line is None else line
            if self._file is None or text[60:80].rstrip() == _FIRST_LABEL:
                results += self._close()
                self._file = NavigationDecoder(self._source_name)
            before = _ionosphere(self._file)
            results += self._file.feed(text.rstrip(b"\r\n") + b"\n")
            after = _ionosphere(self._file)
            if after != before and after is not None:
                results.append(after)
        return results

    def end(self) -> list[NavigationResult | IonosphereCoefficients]:
        """Results that only the end of the file completes."""
        rest = self._lines.take_rest()
        return [*(self.feed(rest + b"\n") if rest else []), *self._close()]

    def _close(self) -> list[NavigationResult]:
        file, self._file = self._file, None
        return [] if file is None else file.finish()


def _ionosphere(file: NavigationDecoder) -> IonosphereCoefficients | None:
    """GPS's coefficients, once both lines were read."""
    known = file.klobuchar.get("G")
    if known is None or known.alpha is None or known.beta is None:
        return None
    return IonosphereCoefficients(system="G", alpha=known.alpha, beta=known.beta)


Decoder = (
    PosDecoder
    | NmeaDecoder
    | UbxDecoder
    | SbfDecoder
    | RtcmDecoder
    | MixedDecoder
    | RinexDecoder
    | NavigationFiles
)


class StreamReader:
    """Incremental reader of one stream; `near_ns` (GPS time) resolves the week of protocols that do not contain it.

    RTCM in a receiver's mixed stream was sent to it: its observations are the base's, not the receiver's.
    """

    def __init__(
        self,
        stream: Stream,
        protocol: StreamProtocol,
        source_name: str,
        near_ns: int,
        utc_date: date | None = None,
    ) -> None:
        self.name = source_name
        self._stream: Stream = stream
        self._decoder = _decoder(stream, protocol, source_name, near_ns=near_ns, utc_date=utc_date)
        self._station: Stream = "base" if protocol == "mixed" and stream == "rover" else stream
        self._has_marker = False

    def feed(self, data: bytes) -> list[StreamItem]:
        """Items that the bytes complete, in order; never raises for what they hold."""
        items = [item for result in self._decoder.feed(data) for item in self._items(result)]
        marker = self._marker()
        return items if marker is None else [(self._stream, marker), *items]

    def fell_silent(self) -> list[StreamItem]:
        """Items that only the end of a file completes."""
        if not isinstance(self._decoder, NavigationFiles):
            return []
        return [item for result in self._decoder.end() for item in self._items(result)]

    def damage(self) -> dict[str, int]:
        """Counts of unusable parts of the stream so far, by the decoders' names of the fault, without zeros."""
        decoder = self._decoder
        inside = [getattr(decoder, name, None) for name in ("messages", "ubx", "sbf", "nmea", "rtcm")]
        counts = {name: getattr(decoder, name, 0) for name in _FRAMING}
        counts |= {name: sum(getattr(part, name, 0) for part in (decoder, *inside)) for name in _CONTENT}
        return {name: count for name, count in counts.items() if count}

    def _items(self, result: object) -> list[StreamItem]:
        if isinstance(result, ReceiverEpoch):
            return [(self._stream, result.epoch)]
        if isinstance(result, BaseStationEpoch):
            return [(self._station, result.epoch)]
        if isinstance(result, ReferenceStation):
            label, virtual = f"rtcm-{result.station_id}", result.is_virtual
            return [
                (
                    self._station,
                    StationPosition(position_ecef_m=result.position_ecef_m, label=label, is_virtual=virtual),
                )
            ]
        return [(self._stream, result)] if isinstance(result, DecodedItem) else []

    def _marker(self) -> StationPosition | None:
        """Antenna position of a RINEX header, once."""
        decoder = self._decoder
        if self._has_marker or not isinstance(decoder, RinexDecoder) or decoder.header is None:
            return None
        self._has_marker = True
        header = decoder.header
        if header.position_ecef_m is None:
            return None
        marker = np.array(header.position_ecef_m)
        latitude, longitude, _ = geodetic(marker)
        up_m, east_m, north_m = header.delta_hen_m or (0.0, 0.0, 0.0)
        x, y, z = marker + np.array([east_m, north_m, up_m]) @ enu_from_ecef_rotation(latitude, longitude)
        if not np.isfinite(latitude):
            return None
        return StationPosition(
            position_ecef_m=(float(x), float(y), float(z)), label=f"rinex-{header.marker or 'unnamed'}"
        )


def _decoder(
    stream: Stream, protocol: StreamProtocol, source_name: str, near_ns: int, utc_date: date | None
) -> Decoder:
    match protocol:
        case "pos":
            return PosDecoder(source_name)
        case "nmea":
            return NmeaDecoder(source_name, utc_date=utc_date)
        case "ubx":
            return UbxDecoder(source_name, near_ns)
        case "sbf":
            return SbfDecoder(source_name)
        case "rtcm":
            return RtcmDecoder(near_ns)
        case "mixed":
            return MixedDecoder(source_name, near_ns, utc_date=utc_date)
        case "rinex":
            return NavigationFiles(source_name) if stream == "ephemerides" else RinexDecoder(source_name)
