"""Decompress LZF, the compression of `binary_compressed` point clouds.

Format (M. Lehmann, "LibLZF", described in its header): a control byte below 32 is followed by that many literal bytes
plus one; any other has in its upper three bits the length of a back reference less two (seven: more in the next byte),
and in its lower five, with the next byte, its distance less one.
"""

from __future__ import annotations


class LzfError(ValueError):
    """The stream is damaged; the text is what was expected."""


def lzf_decompressed(data: bytes, length: int) -> bytes:
    """Decompress a stream to exactly `length` bytes; LzfError for another length or an invalid reference."""
    out = bytearray()
    at, end = 0, len(data)
    while at < end:
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            if at > end:
                raise LzfError("a complete compressed stream")
        else:
            count = control >> 5
            if at + 1 + (count == 7) > end:
                raise LzfError("a complete compressed stream")
            if count == 7:
                count += data[at]
                at += 1
            count += 2
            back = ((control & 31) << 8) + data[at] + 1
            at += 1
            begin = len(out) - back
            if begin < 0:
                raise LzfError("back references within the decompressed data")
            piece = out[begin : begin + count]
            while len(piece) < count:  # an overlapping reference repeats itself
                piece += piece[: count - len(piece)]
            out += piece
        if len(out) > length:
            raise LzfError(f"{length} bytes after decompression")
    if len(out) != length:
        raise LzfError(f"{length} bytes after decompression")
    return bytes(out)
