"""Lines out of a byte stream that arrives in pieces, with a bound on what is kept."""

MAXIMUM_LINE_BYTES = 1024


class LineBuffer:
    """Cuts a stream at newlines. The result does not depend on how the stream was cut into pieces."""

    def __init__(self) -> None:
        self.line_number = 1
        self._partial = bytearray()
        self._dropping = False

    def feed(self, data: bytes) -> list[tuple[int, bytes | None]]:
        """The lines completed by `data` with their numbers, without newline; None for one that is too long.

        A line over 1,024 bytes is reported as soon as it is, and dropped up to the next newline.
        """
        lines: list[tuple[int, bytes | None]] = []
        start = 0
        while True:
            end = data.find(b"\n", start)
            piece = data[start:] if end < 0 else data[start:end]
            if not self._dropping:
                if len(self._partial) + len(piece) > MAXIMUM_LINE_BYTES:
                    lines.append((self.line_number, None))
                    self._partial.clear()
                    self._dropping = True
                else:
                    self._partial += piece
            if end < 0:
                return lines
            if not self._dropping:
                lines.append((self.line_number, bytes(self._partial)))
            self._partial.clear()
            self._dropping = False
            self.line_number += 1
            start = end + 1

    def take_rest(self) -> bytes:
        """What came after the last newline, removed from the buffer."""
        rest = bytes(self._partial)
        self._partial.clear()
        self._dropping = False
        return rest
