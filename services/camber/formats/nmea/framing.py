"""Framing of NMEA 0183 sentences, and their checksum.

Source: NMEA 0183 v4.11, 5.3: `$`, printable characters, `*`, two hexadecimal digits of the exclusive or of everything
between `$` and `*`, carriage return, line feed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from pynmeagps.nmeahelpers import calc_checksum, get_parts

from camber.formats.errors import FormatError
from camber.formats.receiver.frame_search import MAX_SENTENCE_BYTES

_WHOLE = re.compile(rb"\$[^*]*\*[0-9A-Fa-f]{2}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sentence:
    """A sentence with a correct checksum: `kind` is its formatter (`GGA`), `fields` the texts after it."""

    talker: str
    kind: str
    fields: tuple[str, ...]
    byte_offset: int


def parse_sentence(source_name: str, text: bytes, byte_offset: int) -> Sentence | FormatError:
    """Parse a candidate sentence, from its `$` on without the line end; an error where it is malformed."""
    actual = text
    if len(text) > MAX_SENTENCE_BYTES:
        expected = f"at most {MAX_SENTENCE_BYTES} bytes before its end"
    elif not _WHOLE.fullmatch(text):
        expected = "$…*hh and a line end: cut short or interrupted"
    else:
        content, talker, kind, fields, checksum = get_parts(text)
        if calc_checksum(content) == checksum.upper():
            return Sentence(talker=talker, kind=kind, fields=tuple(fields), byte_offset=byte_offset)
        expected = f"checksum {calc_checksum(content)}"
        actual = text[:6] + b"..." + text[-6:]
    return FormatError(source_name, "sentence", expected, actual=actual, byte_offset=byte_offset)
