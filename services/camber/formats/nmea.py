"""NMEA 0183 position streams: GGA with GST and a date, put together epoch by epoch.

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
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path
from typing import Literal

from camber.formats.errors import FormatError
from camber.formats.nmea_framing import Sentence, SentenceBuffer
from camber.formats.nmea_sentences import NS_PER_HOUR, READERS, Gga, Gst, SentenceFields, UtcDate
from camber.formats.nmea_writing import format_gga, format_gst, format_rmc
from camber.formats.receiver_solution import ReceiverSolution
from camber.geodesy.gps_time import NS_PER_DAY, NS_PER_SECOND, CalendarTime, gps_ns_from_utc

__all__ = ["LastSentence", "NmeaDecoder", "format_gga", "format_gst", "format_rmc", "read_nmea"]

LastSentence = Literal["GGA", "GST", "RMC"]

_CHUNK_BYTES = 65536


@dataclass(slots=True)
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
        self, source_name: str, *, utc_date: date | None = None, last_sentence: LastSentence | None = None
    ) -> None:
        self.source_name = source_name
        self.epochs_without_position = 0
        """GGA sentences in which the receiver said that it has no position."""
        self.late_sentences = 0
        """GGA and GST sentences that came after their epoch had been emitted, and were lost."""
        self._sentences = SentenceBuffer(source_name)
        self._fixed_last = last_sentence
        self._last: str | None = last_sentence
        self._previous_last: str | None = None
        self._epoch: _Epoch | None = None
        self._day = utc_date
        self._day_time_of_day_ns: int | None = None

    @property
    def bytes_skipped(self) -> int:
        """Bytes that belong to no sentence: other protocols on the same port, and broken sentences."""
        return self._sentences.bytes_skipped

    def feed(self, data: bytes) -> list[ReceiverSolution | FormatError]:
        """What `data` completes. Never raises; keeps one partial sentence and one epoch at most."""
        return self._handle(self._sentences.feed(data))

    def finish(self) -> list[ReceiverSolution | FormatError]:
        """Call when the stream ended or the receiver has fallen silent: emits the epoch that is waiting."""
        return self._handle(self._sentences.finish()) + self._close()

    def _handle(self, sentences: list[Sentence | FormatError]) -> list[ReceiverSolution | FormatError]:
        results: list[ReceiverSolution | FormatError] = []
        for sentence in sentences:
            if isinstance(sentence, FormatError):
                results.append(sentence)
            elif sentence.kind in READERS and not sentence.talker.startswith("P"):
                results += self._sentence(sentence)
        return results

    def _sentence(self, sentence: Sentence) -> list[ReceiverSolution | FormatError]:
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
        time_of_day_ns = content if isinstance(content, int) else content.time_of_day_ns
        results = self._begin(time_of_day_ns, sentence.kind)
        assert self._epoch is not None
        self._epoch.last_kind = sentence.kind
        results += self._store(self._epoch, sentence, content)
        if sentence.kind == self._last:
            results += self._emit(self._epoch)
        return results

    def _begin(self, time_of_day_ns: int, kind: str) -> list[ReceiverSolution | FormatError]:
        if self._epoch is not None and self._epoch.time_of_day_ns == time_of_day_ns:
            return []
        results = self._close()
        self._epoch = _Epoch(time_of_day_ns, kind)
        return results

    def _store(
        self, epoch: _Epoch, sentence: Sentence, content: Gga | Gst | UtcDate | int
    ) -> list[ReceiverSolution | FormatError]:
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

    def _close(self) -> list[ReceiverSolution | FormatError]:
        """End the epoch that is open, and learn from its last sentence."""
        epoch, self._epoch = self._epoch, None
        if epoch is None:
            return []
        if epoch.gga is not None and self._fixed_last is None:
            if epoch.last_kind == self._previous_last:
                self._last = epoch.last_kind
            self._previous_last = epoch.last_kind
        return self._emit(epoch)

    def _emit(self, epoch: _Epoch) -> list[ReceiverSolution | FormatError]:
        gga = epoch.gga
        if gga is None or epoch.emitted:
            return []
        epoch.emitted = True
        day = epoch.day or self._day_at(epoch.time_of_day_ns)
        if day is None:
            return [
                self._epoch_error(gga, "date", "an RMC or ZDA sentence before this position, or a given date")
            ]
        try:
            time_ns = gps_ns_from_utc(_calendar(day, epoch.time_of_day_ns))
        except ValueError:
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
) -> Iterator[ReceiverSolution | FormatError]:
    """Solutions and errors of a recorded stream. Raises OSError if it cannot be opened or read."""
    decoder = NmeaDecoder(path.name, utc_date=utc_date, last_sentence=last_sentence)
    with path.open("rb") as file:
        while data := file.read(_CHUNK_BYTES):
            yield from decoder.feed(data)
    yield from decoder.finish()


def _calendar(day: date, time_of_day_ns: int) -> CalendarTime:
    # The leap second is the 86,401st of its day.
    leap = time_of_day_ns >= NS_PER_DAY
    seconds, nanosecond = divmod(time_of_day_ns - leap * NS_PER_SECOND, NS_PER_SECOND)
    return CalendarTime(
        day.year, day.month, day.day, seconds // 3600, seconds // 60 % 60, seconds % 60 + leap, nanosecond
    )
