"""Where a command may write: never over what a person or another command has made.

A folder must be new, empty or of an earlier run of the same command, which a file in it shows. A file must be new, or
name the command in its first lines.
"""

from __future__ import annotations

from pathlib import Path

from camber.formats.errors import FormatError

_HEAD_BYTES = 4096  # chosen: far more than the lines that name the command


def check_output_folder(folder: Path, *marks: str) -> None:
    """Raise FormatError for a folder that may not be written into. `marks`: files, as globs, of an earlier run."""
    if folder.exists() and not folder.is_dir():
        raise FormatError(str(folder), "a file", "a folder")
    if not folder.is_dir() or not any(folder.iterdir()) or any(any(folder.glob(mark)) for mark in marks):
        return
    earlier = f" or that of an earlier run (with {marks[0]})" if marks else ""
    raise FormatError(str(folder), "not empty", f"a new folder{earlier}")


def check_output_file(path: Path, made_by: str = "") -> None:
    """Raise FormatError for a file that may not be replaced. `made_by`: the command that its first lines name."""
    if not path.is_file():
        return
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if not made_by or made_by.encode() not in head:
        earlier = f" or one made by {made_by}" if made_by else ""
        raise FormatError(str(path), "exists", f"a new file{earlier}")
