"""RINEX navigation files concatenated on one stream; the decoder itself handles one file."""

from __future__ import annotations

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.line_buffer import LineBuffer
from camber.formats.rinex.navigation_reader import NavigationDecoder, NavigationResult

_FIRST_LABEL = b"RINEX VERSION / TYPE"


class NavigationFiles:
    """Incremental reader; a line with a RINEX version ends the file before and begins the next."""

    def __init__(self, source_name: str) -> None:
        self._source_name = source_name
        self._lines = LineBuffer()
        self._file: NavigationDecoder | None = None

    def feed(self, data: bytes) -> list[NavigationResult | IonosphereCoefficients]:
        """Results that the bytes complete; the last record of a file waits for the next file, or for `end`."""
        results: list[NavigationResult | IonosphereCoefficients] = []
        for _, line in self._lines.feed(data):
            text = b"" if line is None else line
            if self._file is None or text[60:80].rstrip() == _FIRST_LABEL:
                results += self._close()
                self._file = NavigationDecoder(self._source_name)
            before = _ionosphere(self._file)
            results += self._file.feed(text.rstrip(b"\r\n") + b"\n")
            after = _ionosphere(self._file)
            if after != before and after is not None:
                results.append(after)
        return results

    def end(self) -> list[NavigationResult | IonosphereCoefficients]:
        """Results that only the end of the file completes."""
        rest = self._lines.take_rest()
        return [*(self.feed(rest + b"\n") if rest else []), *self._close()]

    def _close(self) -> list[NavigationResult]:
        file, self._file = self._file, None
        return [] if file is None else file.finish()


def _ionosphere(file: NavigationDecoder) -> IonosphereCoefficients | None:
    """GPS's coefficients, once both lines were read."""
    known = file.klobuchar.get("G")
    if known is None or known.alpha is None or known.beta is None:
        return None
    return IonosphereCoefficients(system="G", alpha=known.alpha, beta=known.beta)
