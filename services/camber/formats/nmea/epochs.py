"""NMEA 0183 position streams: GGA with GST and a date, put together epoch by epoch, and GBS.

A GGA sentence says neither its date nor its uncertainty nor the height above the ellipsoid in one number, so:

- the **date** comes from RMC or ZDA in the stream, or is given; it goes on over midnight by itself. Without
one, an epoch is an error, not a guess. UTC becomes GPS time with the leap seconds;
- the **height** is altitude + geoid separation; an empty separation is an error, never a zero;
- the **covariance** comes from the GST of the same time of day, and is None if there is none.

**When a solution comes out.** Sentences of one time of day make one epoch. It ends, and its solution is
emitted, with the sentence kind that usually comes last (`last_sentence`; learned when not given: the kind
that ended two epochs in a row), so without delay. Until that is learned, and whenever that sentence fails to
come, the solution is emitted with the first sentence of the next epoch: a delay of one epoch. At the end of a
stream `finish` emits what is left. Nothing depends on a clock.

A GBS sentence comes out at once, as what the receiver says of its integrity at that time.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path
from typing import Literal

from camber.formats.errors import FormatError
from camber.formats.nmea.framing import Sentence, parse_sentence
from camber.formats.nmea.sentences import NS_PER_HOUR, READERS, Gbs, Gga, Gst, SentenceFields, UtcDate
from camber.formats.nmea.writer import format_gga, format_gst, format_rmc
from camber.formats.receiver.frame_buffer import FrameBuffer
from camber.formats.receiver.integrity_report import IntegrityReport
from camber.formats.receiver.solution import ReceiverSolution
from camber.geodesy.gps_time import (
    NS_PER_DAY,
    NS_PER_SECOND,
    CalendarTime,
    gps_ns_from_utc,
    utc_from_gps_ns,
)
from camber.schemas.gnss import ReceiverIntegrity

NmeaResult = ReceiverSolution | ReceiverIntegrity | FormatError

__all__ = ["LastSentence", "NmeaDecoder", "NmeaResult", "format_gga", "format_gst", "format_rmc", "read_nmea"]

LastSentence = Literal["GGA", "GST", "RMC"]

_CHUNK_BYTES = 65536


@dataclass(slots=True, kw_only=True)
class _Epoch:
    """What has come so far for one time of day."""

    time_of_day_ns: int
    last_kind: str
    gga: Gga | None = None
    gst: Gst | None = None
    day: date | None = None
    emitted: bool = False


class NmeaDecoder:
    """Turns the bytes of a receiver's port, in pieces of any size, into solutions and errors.

    `utc_date` is the UTC date of the first position, for streams without RMC or ZDA (which overrule it).
    """

    def __init__(
        self,
        source_name: str,
        *,
        utc_date: date | None = None,
        last_sentence: LastSentence | None = None,
        statements: IntegrityReport | None = None,
    ) -> None:
        self.source_name = source_name
        self.epochs_without_position = 0
        """GGA sentences in which the receiver said that it has no position."""
        self.late_sentences = 0
        """GGA and GST sentences that came after their epoch had been emitted, and were lost."""
        self._frames = FrameBuffer("nmea")
        self._broken_bytes = 0
        self._statements = IntegrityReport() if statements is None else statements
        self._fixed_last = last_sentence
        self._last: str | None = last_sentence
        self._previous_last: str | None = None
        self._epoch: _Epoch | None = None
        self._day = utc_date
        self._day_time_of_day_ns: int | None = None

    @property
    def bytes_skipped(self) -> int:
        """Bytes that belong to no sentence: other protocols on the same port, and broken sentences."""
        return self._frames.bytes_skipped + self._broken_bytes

    def feed(self, data: bytes) -> list[NmeaResult]:
        """What `data` completes. Never raises; keeps one partial sentence and one epoch at most."""
        return [
            result for frame in self._frames.feed(data) for result in self.take(frame.data, frame.byte_offset)
        ]

    def finish(self) -> list[NmeaResult]:
        """Call when the stream ended or the receiver has fallen silent: emits the epoch that is waiting."""
        frames = self._frames.finish()
        results = [result for frame in frames for result in self.take(frame.data, frame.byte_offset)]
        return results + self._close()

    def take(self, text: bytes, byte_offset: int) -> list[NmeaResult]:
        """What one sentence completes, from its `$` on without the line end, for who has found it already."""
        sentence = parse_sentence(self.source_name, text, byte_offset)
        if isinstance(sentence, FormatError):
            self._broken_bytes += len(text)
            return [sentence]
        if sentence.kind in READERS and not sentence.talker.startswith("P"):
            return self._sentence(sentence)
        return []

    def date_near(self, time_ns: int) -> None:
        """The date from elsewhere, as GPS time, for as long as the stream has not said one."""
        if self._day is None:
            utc = utc_from_gps_ns(time_ns)
            self._day = date(utc.year, utc.month, utc.day)
            self._day_time_of_day_ns = (utc.hour * 3600 + utc.minute * 60 + utc.second) * NS_PER_SECOND

    def _sentence(self, sentence: Sentence) -> list[NmeaResult]:
        fields = SentenceFields(self.source_name, sentence)
        if sentence.kind != "ZDA" and not fields.text(0):
            # Receivers send empty sentences until they know the time.
            self.epochs_without_position += sentence.kind == "GGA"
            return []
        try:
            content = READERS[sentence.kind](fields)
        except FormatError as error:
            return [error]
        if sentence.kind == "ZDA":
            # Some receivers send it at the time of transmission, so it says the date but belongs to no epoch.
            if isinstance(content, UtcDate):
                self._day, self._day_time_of_day_ns = content.day, content.time_of_day_ns
            return []
        assert content is not None
        if isinstance(content, Gbs):
            return self._integrity(content, sentence.byte_offset)
        time_of_day_ns = content if isinstance(content, int) else content.time_of_day_ns
        results = self._begin(time_of_day_ns, sentence.kind)
        assert self._epoch is not None
        self._epoch.last_kind = sentence.kind
        results += self._store(self._epoch, sentence, content)
        if sentence.kind == self._last:
            results += self._emit(self._epoch)
        return results

    def _integrity(self, gbs: Gbs, byte_offset: int) -> list[NmeaResult]:
        day = self._day_at(gbs.time_of_day_ns)
        time_ns = None if day is None else _gps_ns(day, gbs.time_of_day_ns)
        if time_ns is None:
            expected = "a date, from an RMC or ZDA sentence before it or given, on which there is this time"
            return [FormatError(self.source_name, "GBS date", expected, byte_offset=byte_offset)]
        self._statements.say_fault_detection(time_ns, gbs)
        return [*self._statements.at(time_ns)]

    def _begin(self, time_of_day_ns: int, kind: str) -> list[NmeaResult]:
        if self._epoch is not None and self._epoch.time_of_day_ns == time_of_day_ns:
            return []
        results = self._close()
        self._epoch = _Epoch(time_of_day_ns=time_of_day_ns, last_kind=kind)
        return results

    def _store(
        self, epoch: _Epoch, sentence: Sentence, content: Gga | Gst | UtcDate | int
    ) -> list[NmeaResult]:
        if isinstance(content, UtcDate):
            epoch.day = content.day
            self._day, self._day_time_of_day_ns = content.day, content.time_of_day_ns
        elif isinstance(content, int):
            self.epochs_without_position += sentence.kind == "GGA"
        elif epoch.emitted:
            self._lost(content)
        elif isinstance(content, Gst):
            epoch.gst = content
        elif epoch.gga is None:
            epoch.gga = content
        else:
            expected = "one GGA for each time"
            return [FormatError(self.source_name, "sentence", expected, byte_offset=content.byte_offset)]
        return []

    def _lost(self, content: Gga | Gst) -> None:
        self.late_sentences += 1
        if isinstance(content, Gst) and self._fixed_last is None:
            # Learned wrongly: wait for whole epochs and learn again.
            self._last = self._previous_last = None

    def _close(self) -> list[NmeaResult]:
        """End the epoch that is open, and learn from its last sentence."""
        epoch, self._epoch = self._epoch, None
        if epoch is None:
            return []
        if epoch.gga is not None and self._fixed_last is None:
            if epoch.last_kind == self._previous_last:
                self._last = epoch.last_kind
            self._previous_last = epoch.last_kind
        return self._emit(epoch)

    def _emit(self, epoch: _Epoch) -> list[NmeaResult]:
        gga = epoch.gga
        if gga is None or epoch.emitted:
            return []
        epoch.emitted = True
        day = epoch.day or self._day_at(epoch.time_of_day_ns)
        if day is None:
            return [
                self._epoch_error(gga, "date", "an RMC or ZDA sentence before this position, or a given date")
            ]
        time_ns = _gps_ns(day, epoch.time_of_day_ns)
        if time_ns is None:
            return [self._epoch_error(gga, "time", "a UTC time that exists, from 1980-01-06 on")]
        self._day, self._day_time_of_day_ns = day, epoch.time_of_day_ns
        return [
            ReceiverSolution(
                time_ns=time_ns,
                latitude_rad=gga.latitude_rad,
                longitude_rad=gga.longitude_rad,
                height_m=gga.height_m,
                quality=gga.quality,
                satellites=gga.satellites,
                covariance_enu_m2=None if epoch.gst is None else epoch.gst.covariance_enu_m2,
                age_s=gga.age_s,
                station=gga.station,
            )
        ]

    def _epoch_error(self, gga: Gga, field: str, expected: str) -> FormatError:
        return FormatError(self.source_name, f"GGA {field}", expected, byte_offset=gga.byte_offset)

    def _day_at(self, time_of_day_ns: int) -> date | None:
        """The day on which this time of day is within twelve hours of the last known one."""
        if self._day is None or self._day_time_of_day_ns is None:
            return self._day
        difference_ns = time_of_day_ns - self._day_time_of_day_ns
        days = (difference_ns < -12 * NS_PER_HOUR) - (difference_ns > 12 * NS_PER_HOUR)
        try:
            return self._day + timedelta(days=days)
        except OverflowError:
            return None


def read_nmea(
    path: Path, *, utc_date: date | None = None, last_sentence: LastSentence | None = None
) -> Iterator[NmeaResult]:
    """Solutions and errors of a recorded stream. Raises OSError if it cannot be opened or read."""
    decoder = NmeaDecoder(path.name, utc_date=utc_date, last_sentence=last_sentence)
    with path.open("rb") as file:
        while data := file.read(_CHUNK_BYTES):
            yield from decoder.feed(data)
    yield from decoder.finish()


def _gps_ns(day: date, time_of_day_ns: int) -> int | None:
    try:
        return gps_ns_from_utc(_calendar(day, time_of_day_ns))
    except ValueError:
        return None


def _calendar(day: date, time_of_day_ns: int) -> CalendarTime:
    # The leap second is the 86,401st of its day.
    leap = time_of_day_ns >= NS_PER_DAY
    seconds, nanosecond = divmod(time_of_day_ns - leap * NS_PER_SECOND, NS_PER_SECOND)
    return CalendarTime(
        day.year, day.month, day.day, seconds // 3600, seconds // 60 % 60, seconds % 60 + leap, nanosecond
    )
