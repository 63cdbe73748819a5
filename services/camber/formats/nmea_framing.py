"""NMEA 0183 sentences out of a byte stream in which other protocols may be interleaved.

Source: NMEA 0183 v4.11, 5.3: `$`, printable characters, `*`, two hexadecimal digits of the exclusive or of
everything between `$` and `*`, carriage return, line feed.
"""

import re
from dataclasses import dataclass

from pynmeagps.nmeahelpers import calc_checksum, get_parts

from camber.formats.errors import FormatError

# NMEA allows 82, but receivers exceed it in high-precision modes and proprietary sentences.
MAXIMUM_SENTENCE_BYTES = 1024

_END = re.compile(rb"[^\x20-\x23\x25-\x7e]")
_LOOKS_LIKE_A_SENTENCE = re.compile(rb"\$[A-Z]{2}")
_WHOLE = re.compile(rb"\$[^*]*\*[0-9A-Fa-f]{2}")


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence whose checksum is right: `kind` is its formatter (`GGA`), `fields` what follows, as text."""

    talker: str
    kind: str
    fields: tuple[str, ...]
    byte_offset: int


class SentenceBuffer:
    """Cuts a stream into sentences. The result does not depend on how the stream was cut into pieces."""

    def __init__(self, source_name: str) -> None:
        self.source_name = source_name
        self.bytes_skipped = 0
        """Bytes that belong to no sentence, line ends apart: other protocols and broken sentences."""
        self._buffer = bytearray()
        self._buffer_offset = 0

    def feed(self, data: bytes) -> list[Sentence | FormatError]:
        """The sentences completed by `data`, and an error for each that is cut short, too long or corrupt."""
        self._buffer += data
        buffer, results, position = self._buffer, list[Sentence | FormatError](), 0
        while True:
            start = buffer.find(b"$", position)
            if start < 0:
                self._skip(buffer[position:])
                position = len(buffer)
                break
            self._skip(buffer[position:start])
            end_match = _END.search(buffer, start + 1)
            end = len(buffer) if end_match is None else end_match.start()
            if end_match is None and end - start <= MAXIMUM_SENTENCE_BYTES:
                position = start
                break
            # Of a sentence that is too long only the allowed part is taken: the rest is found to be no
            # sentence.
            end = min(end, start + MAXIMUM_SENTENCE_BYTES + 1)
            results += self._take(bytes(buffer[start:end]), self._buffer_offset + start)
            position = end
        self._buffer_offset += position
        del buffer[:position]
        return results

    def finish(self) -> list[Sentence | FormatError]:
        """Call at the end of the stream: takes a last sentence that has its checksum but no line end."""
        rest, offset = bytes(self._buffer), self._buffer_offset
        self._buffer_offset += len(rest)
        self._buffer.clear()
        return self._take(rest, offset) if rest else []

    def _skip(self, data: bytes | bytearray) -> None:
        self.bytes_skipped += len(data) - data.count(b"\r") - data.count(b"\n")

    def _take(self, text: bytes, offset: int) -> list[Sentence | FormatError]:
        if not _LOOKS_LIKE_A_SENTENCE.match(text):
            # A dollar sign inside a binary message.
            self._skip(text)
            return []
        if len(text) > MAXIMUM_SENTENCE_BYTES:
            expected = f"at most {MAXIMUM_SENTENCE_BYTES} bytes before its end"
        elif not _WHOLE.fullmatch(text):
            expected = "$…*hh and a line end: cut short or interrupted"
        else:
            content, talker, kind, fields, checksum = get_parts(text)
            if calc_checksum(content) == checksum.upper():
                return [Sentence(talker, kind, tuple(fields), offset)]
            expected = f"checksum {calc_checksum(content)}"
        self._skip(text)
        # The end is shown too when it is the checksum that is wrong.
        found = text if "checksum" not in expected else text[:6] + b"..." + text[-6:]
        return [FormatError(self.source_name, "sentence", expected, found=found, byte_offset=offset)]
