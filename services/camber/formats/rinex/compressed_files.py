"""RINEX text of plain, gzip or Hatanaka-compressed files (`.crx`, `.21d`), recognised by their content.

Hatanaka compression, and the compressions other than gzip, need the optional package `hatanaka` (MIT), which contains
the RNXCMP programs: Y. Hatanaka, "A Compression Format and Tools for GNSS Observation Data", Bulletin of the Geospatial
Information Authority of Japan 55 (2008), 21-30.
"""

from __future__ import annotations

import gzip
import io
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, cast

from camber.formats.errors import FormatError

_CHUNK_BYTES = 1 << 20  # chosen: memory of a file reader
_GZIP = b"\x1f\x8b"
_OTHER = (b"\x1f\x9d", b"BZh", b"PK\x03\x04")
_CRINEX = b"CRINEX VERS"


def rinex_chunks(path: Path) -> Iterator[bytes]:
    """Yield the RINEX text of a file in chunks.

    Raises OSError if it cannot be opened; FormatError where a compression is corrupt, after the text before the corrupt
    part, or needs a package that is not installed.
    """
    with path.open("rb") as file:
        head = file.read(80)
        file.seek(0)
        if head.startswith(_GZIP):
            with gzip.open(file) as inner:
                yield from _text_chunks(cast(IO[bytes], inner), path.name)
        else:
            yield from _text_chunks(file, path.name)


def _text_chunks(file: IO[bytes], name: str) -> Iterator[bytes]:
    chunks = _file_chunks(file, name)
    first = next(chunks, b"")
    if first.startswith(_OTHER) or _CRINEX in first[:80]:
        yield from _decompressed(first + b"".join(chunks), name)
        return
    yield first
    yield from chunks


def _file_chunks(file: IO[bytes], name: str) -> Iterator[bytes]:
    """Yield chunks of one size; where the compression is corrupt, first the bytes before."""
    read = cast(io.BufferedReader, file).read1
    chunk, failure = bytearray(), None
    while failure is None:
        try:
            part = read(_CHUNK_BYTES)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            part, failure = b"", error
        chunk += part
        if len(chunk) >= _CHUNK_BYTES or (chunk and not part):
            yield bytes(chunk)
            chunk.clear()
        if not part:
            break
    if failure is not None:
        raise FormatError(name, "gzip compression", f"it whole and undamaged ({failure})") from failure


def _decompressed(data: bytes, name: str) -> Iterator[bytes]:
    try:
        import hatanaka  # type: ignore[import-untyped]
    except ImportError as error:
        expected = "the package hatanaka to read it: pip install 'camber[engine]'"
        raise FormatError(name, "Hatanaka compression", expected) from error
    try:
        with warnings.catch_warnings():
            # The program warns of lines that it omits; the decoder checks the remaining text.
            warnings.simplefilter("ignore")
            text: bytes = hatanaka.decompress(data)
    except Exception as error:  # the decompressors raise many types
        reason = " ".join(str(error).split())[:120]
        raise FormatError(name, "compression", f"it whole and undamaged ({reason})") from error
    for start in range(0, len(text), _CHUNK_BYTES):
        yield text[start : start + _CHUNK_BYTES]
