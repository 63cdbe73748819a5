"""The one error of every reader in this package."""

_SHOWN_CHARACTERS = 40


class FormatError(ValueError):
    """Something in a file or stream that cannot be understood; its text is one clear line.

    Streaming decoders hand it out among their results instead of raising it, so that one bad line costs one
    line. `line_number` counts from 1, `byte_offset` from 0; either is None where the format has no such
    thing.
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
        self.actual = None if actual is None else _shown(actual)
        self.line_number = line_number
        self.byte_offset = byte_offset
        place = source_name
        if line_number is not None:
            place += f":{line_number}"
        if byte_offset is not None:
            place += f" at byte {byte_offset}"
        actual_text = "" if self.actual is None else f" is '{self.actual}'"
        super().__init__(f"{place}: {field}{actual_text}, expected {expected}")


def _shown(actual: str | bytes) -> str:
    """At most forty printable characters, whatever the input was."""
    text = actual.decode("latin-1") if isinstance(actual, bytes) else actual
    visible = text[:_SHOWN_CHARACTERS].encode("unicode_escape").decode("ascii")
    return visible + ("…" if len(text) > _SHOWN_CHARACTERS else "")
