"""The files of the repository, for tests that look at the house itself."""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCE_ROOTS = (ROOT / "schemas" / "camber", ROOT / "services" / "camber")


def tracked_files() -> list[Path]:
    """What is in the repository or about to be: all that git does not ignore."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return [path for name in sorted(listed.stdout.split("\0")) if name and (path := ROOT / name).is_file()]


def modules() -> list[tuple[str, Path]]:
    """Every module of the sources: dotted name, with `__init__` for a package itself, and file."""
    return [
        (".".join(path.relative_to(root.parent).with_suffix("").parts), path)
        for root in SOURCE_ROOTS
        for path in sorted(root.rglob("*.py"))
    ]
