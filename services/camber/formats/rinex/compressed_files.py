"""RINEX files as they lie on disks: plain, gzip, Hatanaka compression (`.crx`, `.21d`), or both; told by their content.

Hatanaka compression, and the compressions other than gzip, need the optional package `hatanaka` (MIT), which brings the
RNXCMP programs: Y. Hatanaka, "A Compression Format and Tools for GNSS Observation Data", Bulletin of the Geospatial
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

_PIECE_BYTES = 1 << 20
_GZIP = b"\x1f\x8b"
_OTHER = (b"\x1f\x9d", b"BZh", b"PK\x03\x04")
_CRINEX = b"CRINEX VERS"


def rinex_chunks(path: Path) -> Iterator[bytes]:
    """The RINEX text of a file, in pieces. Raises OSError if it cannot be opened, FormatError where a compression is
    damaged or needs a package that is not installed; what came before a damage is given out first."""
    with path.open("rb") as file:
        head = file.read(80)
        file.seek(0)
        if head.startswith(_GZIP):
            with gzip.open(file) as inner:
                yield from _pieces(cast(IO[bytes], inner), path.name)
        else:
            yield from _pieces(file, path.name)


def _pieces(file: IO[bytes], name: str) -> Iterator[bytes]:
    pieces = _whole_pieces(file, name)
    piece = next(pieces, b"")
    if piece.startswith(_OTHER) or _CRINEX in piece[:80]:
        yield from _decompressed(piece + b"".join(pieces), name)
        return
    yield piece
    yield from pieces


def _whole_pieces(file: IO[bytes], name: str) -> Iterator[bytes]:
    """Pieces of one size; before a damage is told, what came before it."""
    read = cast(io.BufferedReader, file).read1
    piece, damage = bytearray(), None
    while damage is None:
        try:
            part = read(_PIECE_BYTES)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            part, damage = b"", error
        piece += part
        if len(piece) >= _PIECE_BYTES or (piece and not part):
            yield bytes(piece)
            piece.clear()
        if not part:
            break
    if damage is not None:
        raise FormatError(name, "gzip compression", f"it whole and undamaged ({damage})") from damage


def _decompressed(data: bytes, name: str) -> Iterator[bytes]:
    try:
        import hatanaka  # type: ignore[import-untyped]
    except ImportError as error:
        raise FormatError(
            name, "Hatanaka compression", "the package hatanaka to read it: pip install 'camber[engine]'"
        ) from error
    try:
        with warnings.catch_warnings():
            # The program warns of lines that it leaves out; the text that remains is judged by who reads it.
            warnings.simplefilter("ignore")
            text: bytes = hatanaka.decompress(data)
    except Exception as error:  # its decompressors raise what they like
        reason = " ".join(str(error).split())[:120]
        raise FormatError(name, "compression", f"it whole and undamaged ({reason})") from error
    for start in range(0, len(text), _PIECE_BYTES):
        yield text[start : start + _PIECE_BYTES]
