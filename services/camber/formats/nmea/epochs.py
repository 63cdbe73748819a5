"""NMEA 0183 position streams: GGA, GST and a date combined by epoch; GBS; GSV with GSA.

A GGA sentence contains neither its date nor its uncertainty nor the ellipsoidal height in one number, so:

- the **date** is that of RMC or ZDA in the stream, or given; it advances at midnight by itself. Without a date, an
  epoch is an error. UTC becomes GPS time with the leap seconds;
- the **height** is altitude + geoid separation; an empty separation is an error, never a zero;
- the **covariance** is that of the GST of the same time of day, None if there is none.

**When a solution is returned.** Sentences of one time of day make one epoch. It ends, and its solution is returned,
with the kind of sentence that is usually the last (learnt: the kind that ended two epochs in a row), so without delay.
Until that is learnt, and whenever that sentence is missing, the solution is returned with the first sentence of the
next epoch: a delay of one epoch. At the end of a stream `finish` returns the rest. Nothing depends on a clock.

A GBS sentence is returned at once, as the receiver's integrity report of that time.

GSV and GSA contain no time: they belong to the epoch in which they stand, and are returned when the next one begins.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path

from camber.formats.errors import FormatError
from camber.formats.nmea import satellite_sentences
from camber.formats.nmea.sentences import READERS, Sentence, SentenceContent, SentenceFields, parse_sentence
from camber.formats.receiver.frame_buffer import Frame, FramedDecoder
from camber.formats.receiver.integrity_report import IntegrityReport
from camber.formats.receiver.satellite_report import SatelliteReport
from camber.formats.receiver.solution import Fields, ReceiverSolution
from camber.geodesy.covariance import EnuCovariance
from camber.geodesy.gps_time import (
    NS_PER_DAY,
    NS_PER_SECOND,
    CalendarTime,
    gps_ns_from_utc,
    utc_from_gps_ns,
)
from camber.schemas.gnss import ReceiverIntegrity

NmeaResult = ReceiverSolution | ReceiverIntegrity | SatelliteReport | FormatError
_KINDS = {*READERS, *satellite_sentences.KINDS}
_CHUNK_BYTES = 65536  # chosen: memory of a file reader


@dataclass(slots=True, kw_only=True)
class _NmeaEpoch:
    """The sentences received so far with one time of day; `byte_offset` is that of GGA."""

    time_of_day_ns: int
    last_kind: str
    has_gga: bool = False
    solution: Fields | None = None
    byte_offset: int = 0
    covariance_enu_m2: EnuCovariance | None = None
    day: date | None = None
    emitted: bool = False


class NmeaDecoder(FramedDecoder[NmeaResult]):
    """Decodes the bytes of a receiver's port to solutions and errors.

    `utc_date` is the UTC date of the first position, for streams without RMC or ZDA (which override it).
    """

    def __init__(
        self,
        source_name: str,
        *,
        utc_date: date | None = None,
        report: IntegrityReport | None = None,
    ) -> None:
        super().__init__("nmea")
        self.source_name = source_name
        self.epochs_without_position = 0
        """GGA sentences of a receiver without position."""
        self.late_sentences = 0
        """GGA and GST sentences received after their epoch had been emitted, and lost."""
        self.satellites = satellite_sentences.SatelliteSentences()
        """With the counters of GSV and GSA."""
        self._malformed_bytes = 0
        self._report = IntegrityReport() if report is None else report
        self._last: str | None = None
        self._previous_last: str | None = None
        self._epoch: _NmeaEpoch | None = None
        self._day = utc_date
        self._day_time_of_day_ns: int | None = None

    @property
    def bytes_skipped(self) -> int:
        """Bytes that are not part of a sentence: other protocols on the same port, and malformed sentences."""
        return super().bytes_skipped + self._malformed_bytes

    @property
    def incomplete(self) -> int:
        """Groups of GSV with a missing or repeated sentence."""
        return self.satellites.incomplete

    def _take(self, frame: Frame) -> list[NmeaResult]:
        return self.take(frame.data, frame.byte_offset)

    def take(self, text: bytes, byte_offset: int) -> list[NmeaResult]:
        """Return the results that one sentence completes, from its `$` on without the line end."""
        sentence = parse_sentence(self.source_name, text, byte_offset)
        if isinstance(sentence, FormatError):
            self._malformed_bytes += len(text)
            return [sentence]
        if sentence.kind in _KINDS and not sentence.talker.startswith("P"):
            return self._sentence(sentence)
        return []

    def set_date_near(self, time_ns: int) -> None:
        """Set the date of another source, as GPS time, while the stream has not contained one."""
        if self._day is None:
            utc = utc_from_gps_ns(time_ns)
            of_day_s = utc.hour * 3600 + utc.minute * 60 + utc.second
            self._set_day(date(utc.year, utc.month, utc.day), of_day_s * NS_PER_SECOND)

    def _set_day(self, day: date, time_of_day_ns: int) -> None:
        self._day, self._day_time_of_day_ns = day, time_of_day_ns

    def _sentence(self, sentence: Sentence) -> list[NmeaResult]:
        fields = SentenceFields(self.source_name, sentence)
        try:
            if sentence.kind in satellite_sentences.KINDS:
                self.satellites.take(sentence.kind, fields)
                return []
            if not fields.text(0):
                # Receivers send empty sentences until they know the time.
                self.epochs_without_position += sentence.kind == "GGA"
                return self._end() if sentence.kind == "GGA" else []
            content = READERS[sentence.kind](fields)
        except FormatError as error:
            return [error]
        if sentence.kind == "ZDA":
            # Some receivers send it at the time of transmission, so it sets the date but belongs to no epoch.
            if content.day is not None:
                self._set_day(content.day, content.time_of_day_ns)
            return []
        if content.integrity is not None:
            return self._integrity(content.time_of_day_ns, content.integrity, sentence.byte_offset)
        results = list[NmeaResult]()
        if self._epoch is None or self._epoch.time_of_day_ns != content.time_of_day_ns:
            results = self._end()
            self._epoch = _NmeaEpoch(time_of_day_ns=content.time_of_day_ns, last_kind=sentence.kind)
        epoch = self._epoch
        epoch.last_kind = sentence.kind
        epoch.has_gga |= sentence.kind == "GGA"
        results += self._store(epoch, sentence, content)
        if sentence.kind == self._last:
            results += self._emit(epoch)
        return results

    def _integrity(self, time_of_day_ns: int, integrity: Fields, byte_offset: int) -> list[NmeaResult]:
        day = self._day_at(time_of_day_ns)
        time_ns = None if day is None else _gps_ns(day, time_of_day_ns)
        if time_ns is None:
            expected = "a date, from an RMC or ZDA sentence before it or given, on which there is this time"
            return [FormatError(self.source_name, "GBS date", expected, byte_offset=byte_offset)]
        self._report.update("fault_detection", time_ns, integrity)
        return [*self._report.at(time_ns)]

    def _store(self, epoch: _NmeaEpoch, sentence: Sentence, content: SentenceContent) -> list[NmeaResult]:
        if content.day is not None:
            epoch.day = content.day
            self._set_day(content.day, content.time_of_day_ns)
        elif sentence.kind != "GST" and content.solution is None:
            self.epochs_without_position += sentence.kind == "GGA"
        elif epoch.emitted:
            self.late_sentences += 1
            if sentence.kind == "GST":
                # Learnt wrongly: return whole epochs and learn again.
                self._last = self._previous_last = None
        elif sentence.kind == "GST":
            epoch.covariance_enu_m2 = content.covariance_enu_m2
        elif epoch.solution is None:
            epoch.solution, epoch.byte_offset = content.solution, sentence.byte_offset
        else:
            expected = "one GGA for each time"
            return [FormatError(self.source_name, "sentence", expected, byte_offset=sentence.byte_offset)]
        return []

    def _end(self) -> list[NmeaResult]:
        """End the open epoch, and learn from its last sentence."""
        epoch, self._epoch = self._epoch, None
        satellites = self.satellites.take_view()
        if epoch is None:
            return []
        if epoch.solution is not None:
            if epoch.last_kind == self._previous_last:
                self._last = epoch.last_kind
            self._previous_last = epoch.last_kind
        results = self._emit(epoch)
        day = epoch.day or self._day_at(epoch.time_of_day_ns)
        time_ns = None if day is None else _gps_ns(day, epoch.time_of_day_ns)
        if satellites is None or time_ns is None or not epoch.has_gga:
            return results
        quality = None if epoch.solution is None else epoch.solution["quality"]
        return [*results, SatelliteReport(time_ns=time_ns, quality=quality, satellites=satellites)]

    def _emit(self, epoch: _NmeaEpoch) -> list[NmeaResult]:
        if epoch.solution is None or epoch.emitted:
            return []
        epoch.emitted = True
        day = epoch.day or self._day_at(epoch.time_of_day_ns)
        time_ns = None if day is None else _gps_ns(day, epoch.time_of_day_ns)
        if day is None or time_ns is None:
            field, expected = "GGA time", "a UTC time that exists, from 1980-01-06 on"
            if day is None:
                field, expected = "GGA date", "an RMC or ZDA sentence before this position, or a given date"
            return [FormatError(self.source_name, field, expected, byte_offset=epoch.byte_offset)]
        self._set_day(day, epoch.time_of_day_ns)
        covariance_enu_m2 = epoch.covariance_enu_m2
        return [ReceiverSolution(time_ns=time_ns, covariance_enu_m2=covariance_enu_m2, **epoch.solution)]

    def _day_at(self, time_of_day_ns: int) -> date | None:
        """Return the day on which this time of day is within twelve hours of the last known one."""
        if self._day is None or self._day_time_of_day_ns is None:
            return self._day
        difference_ns = time_of_day_ns - self._day_time_of_day_ns
        days = (difference_ns < -NS_PER_DAY // 2) - (difference_ns > NS_PER_DAY // 2)
        try:
            return self._day + timedelta(days=days)
        except OverflowError:
            return None


def read_nmea(path: Path, *, utc_date: date | None = None) -> Iterator[NmeaResult]:
    """Decode a recorded stream. Raises OSError if it cannot be opened or read."""
    decoder = NmeaDecoder(path.name, utc_date=utc_date)
    with path.open("rb") as file:
        while data := file.read(_CHUNK_BYTES):
            yield from decoder.feed(data)
    yield from decoder.finish()


def _gps_ns(day: date, time_of_day_ns: int) -> int | None:
    # The leap second is the 86,401st of its day.
    leap = time_of_day_ns >= NS_PER_DAY
    seconds, nanosecond = divmod(time_of_day_ns - leap * NS_PER_SECOND, NS_PER_SECOND)
    time = (seconds // 3600, seconds // 60 % 60, seconds % 60 + leap, nanosecond)
    try:
        return gps_ns_from_utc(CalendarTime(day.year, day.month, day.day, *time))
    except ValueError:
        return None
