"""Refuse XML with a DOCTYPE, in whatever encoding: entities are defined in it, and can grow without bound."""

from __future__ import annotations

from xml.parsers import expat

from camber.formats.errors import FormatError

_PART_BYTES = 256  # chosen: so little is read behind a DOCTYPE before it is refused


def refuse_doctype(data: bytes, file: str) -> None:
    """Raise FormatError for a document with a DOCTYPE.

    It can only stand before the first element, so no more is read. What is malformed until there is left to the reader,
    which uses the same parser.
    """
    seen: list[str] = []
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = lambda *_: seen.append("DOCTYPE")
    parser.StartElementHandler = lambda *_: seen.append("element")
    try:
        for begin in range(0, len(data), _PART_BYTES):
            parser.Parse(data[begin : begin + _PART_BYTES], False)
            if seen:
                break
    except (expat.ExpatError, ValueError, LookupError):  # the last two: an encoding that there is not
        pass
    if seen[:1] == ["DOCTYPE"]:
        raise FormatError(file, "XML", "a document without a DOCTYPE")
