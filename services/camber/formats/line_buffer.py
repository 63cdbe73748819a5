"""Lines of a byte stream that arrives in chunks, with bounded memory."""

MAXIMUM_LINE_BYTES = 1024  # chosen: ten times a RINEX navigation line; rows of `.pos` files have about 300


class LineBuffer:
    """Splits a stream at newlines. The result does not depend on how the stream is chunked."""

    def __init__(self) -> None:
        self.line_number = 1
        self._partial = bytearray()
        self._dropping = False

    def feed(self, data: bytes) -> list[tuple[int, bytes | None]]:
        """Return the lines completed by `data` with their numbers, without newline; None for one that is too long.

        A line above `MAXIMUM_LINE_BYTES` is reported at once and dropped up to the next newline.
        """
        lines: list[tuple[int, bytes | None]] = []
        start = 0
        while True:
            end = data.find(b"\n", start)
            part = data[start:] if end < 0 else data[start:end]
            if not self._dropping:
                if len(self._partial) + len(part) > MAXIMUM_LINE_BYTES:
                    lines.append((self.line_number, None))
                    self._partial.clear()
                    self._dropping = True
                else:
                    self._partial += part
            if end < 0:
                return lines
            if not self._dropping:
                lines.append((self.line_number, bytes(self._partial)))
            self._partial.clear()
            self._dropping = False
            self.line_number += 1
            start = end + 1

    def take_rest(self) -> bytes:
        """Return the bytes after the last newline and remove them."""
        rest = bytes(self._partial)
        self._partial.clear()
        self._dropping = False
        return rest
