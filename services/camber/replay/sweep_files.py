"""A drive's sweeps: one file each, listed at the start and read one at a time, when their time has come."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from camber.formats.errors import FormatError
from camber.formats.map_exchange.pcd import read_sweep, sweep_time_ns
from camber.schemas.lidar import Sweep

SENSOR = "lidar"
_LONGEST_NOTE = 500  # characters of a note (`RunFacts.notes`)


@dataclass(frozen=True, slots=True)
class SweepFile:
    """A sweep that has not been read; `time_ns` is that of its end."""

    time_ns: int
    path: Path

    def read(self) -> Sweep:
        """Raises FormatError for a damaged file, OSError where it cannot be read."""
        return read_sweep(self.path, SENSOR)


def sweep_files(folder: Path) -> tuple[list[SweepFile], list[str]]:
    """The sweeps of a folder in the order of time, and a line for each `.pcd` whose name is no time."""
    files: list[SweepFile] = []
    nameless: list[str] = []
    for path in folder.glob("*.pcd"):
        try:
            files.append(SweepFile(sweep_time_ns(path), path))
        except FormatError as error:
            nameless.append(f"a sweep is left out: {error}"[:_LONGEST_NOTE])
    return sorted(files, key=lambda file: file.time_ns), sorted(nameless)


class SweepReader:
    """Reads sweeps; one that cannot be read costs itself, and is counted in `lost`."""

    def __init__(self) -> None:
        self.lost = 0
        self._first = ""

    def read(self, files: Iterable[SweepFile]) -> Iterator[Sweep]:
        """One after the other; those that cannot be read are left out."""
        for file in files:
            try:
                yield file.read()
            except (FormatError, OSError) as error:
                reason = (
                    str(error) if isinstance(error, FormatError) else f"{file.path.name}: {error.strerror}"
                )
                self._first = self._first or reason
                self.lost += 1

    def notes(self) -> tuple[str, ...]:
        """A line that says how many could not be read and why the first could not; nothing where all could."""
        if not self.lost:
            return ()
        note = f"{self.lost} sweep{'s' * (self.lost > 1)} could not be read and left out, the first: {self._first}"
        return (note[:_LONGEST_NOTE],)
