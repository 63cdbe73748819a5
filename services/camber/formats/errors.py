"""The error of every reader in this package."""

_SHOWN_CHARACTERS = 40  # chosen: enough to recognise a field, short enough for one line


class FormatError(ValueError):
    """Malformed content of a file or stream; its text is one line.

    Streaming decoders return it among their results instead of raising it, so that a malformed line costs only that
    line. `line_number` counts from 1, `byte_offset` from 0; None where the format has no such thing.
    """

    def __init__(
        self,
        source_name: str,
        field: str,
        expected: str,
        *,
        actual: str | bytes | None = None,
        line_number: int | None = None,
        byte_offset: int | None = None,
    ) -> None:
        self.source_name = source_name
        self.field = field
        self.expected = expected
        self.actual = None if actual is None else _printable(actual)
        self.line_number = line_number
        self.byte_offset = byte_offset
        place = source_name
        if line_number is not None:
            place += f":{line_number}"
        if byte_offset is not None:
            place += f" at byte {byte_offset}"
        actual_text = "" if self.actual is None else f" is '{self.actual}'"
        super().__init__(f"{place}: {field}{actual_text}, expected {expected}")


def _printable(actual: str | bytes) -> str:
    """Return at most forty printable characters of any input."""
    text = actual.decode("latin-1") if isinstance(actual, bytes) else actual
    visible = text[:_SHOWN_CHARACTERS].encode("unicode_escape").decode("ascii")
    return visible + ("…" if len(text) > _SHOWN_CHARACTERS else "")
