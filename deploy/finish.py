"""Make a folder of installed packages ready for an image: what nobody imports goes, what is left is always the same.

usage: finish.py FOLDER; SOURCE_DATE_EPOCH names the latest time that a file may bear.

Byte code is made here once, and with the digest of its source in place of its time, which no two builds share.
"""

import compileall
import os
import py_compile
import shutil
import sys
from pathlib import Path

UNUSED = (
    "numpy/**/tests",
    "numba/**/tests",
    "zstandard/_cffi.*",  # a second copy of all that it does, for interpreters other than CPython
    "**/*.pyi",
)


def main(folder: Path, latest_s: int) -> None:
    """Remove, compile, date."""
    for packages in folder.glob("lib/python3*/site-packages"):
        for pattern in UNUSED:
            for path in list(packages.glob(pattern)):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        compileall.compile_dir(
            packages,
            maxlevels=30,
            quiet=2,
            # What the interpreter need not look up again: nobody edits a file of an image.
            invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH,
        )
    for path in (*folder.rglob("*"), folder):
        if path.lstat().st_mtime > latest_s:
            os.utime(path, (latest_s, latest_s), follow_symlinks=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(os.environ["SOURCE_DATE_EPOCH"]))
