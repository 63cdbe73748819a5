"""LZF, the compression of `binary_compressed` point clouds: only taking apart.

The stream is a row of pieces (M. Lehmann, "LibLZF", the format as described in its header): a byte below 32 is
followed by that many bytes plus one, as they are; any other says in its upper three bits how many bytes to repeat,
less two (seven: more in the next byte), and in its lower five with the next byte how far back they begin, less one.
"""

from __future__ import annotations


class LzfError(ValueError):
    """The stream is damaged; the text says what was expected."""


def lzf_decompressed(data: bytes, length: int) -> bytes:
    """The `length` bytes of a whole stream. Raises LzfError if it holds more, fewer, or points before its beginning."""
    out = bytearray()
    at, end = 0, len(data)
    while at < end:
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            if at > end:
                raise LzfError("a compressed stream that does not end within a piece")
        else:
            count = control >> 5
            if at + 1 + (count == 7) > end:
                raise LzfError("a compressed stream that does not end within a piece")
            if count == 7:
                count += data[at]
                at += 1
            count += 2
            back = ((control & 31) << 8) + data[at] + 1
            at += 1
            begin = len(out) - back
            if begin < 0:
                raise LzfError("a compressed stream that repeats only what it has said")
            piece = out[begin : begin + count]
            while len(piece) < count:  # it repeats what it is just writing
                piece += piece[: count - len(piece)]
            out += piece
        if len(out) > length:
            raise LzfError(f"{length} bytes once taken apart")
    if len(out) != length:
        raise LzfError(f"{length} bytes once taken apart")
    return bytes(out)
