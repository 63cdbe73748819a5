"""Licences of shared libraries and programs inside installed packages: `bundled_licences.py`.

Package metadata, which pip-licenses reads, does not state them. Exit code 1 names each file whose licence has not been
reviewed or may not be shipped.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import NamedTuple

BUNDLED = {
    "crx2rnx": "LicenseRef-RNXCMP",
    "libbz2": "bzip2-1.0.6",
    "libLerc": "Apache-2.0",
    "liblz4": "BSD-2-Clause",
    "libOpen3D": "MIT",
    "libXau": "MIT-open-group",
    "libaec": "BSD-2-Clause",
    "libavif": "BSD-2-Clause",
    "libblosc": "BSD-3-Clause",
    "libbrotlicommon": "MIT",
    "libbrotlidec": "MIT",
    "libcrypto": "Apache-2.0",
    "libcurl": "curl",
    "libdeflate": "MIT",
    "libfreetype": "FTL OR GPL-2.0-only",
    "libgdal": "MIT",
    "libgeos": "LGPL-2.1-only",
    "libgeos_c": "LGPL-2.1-only",
    "libgfortran": "GPL-3.0-or-later WITH GCC-exception-3.1",
    "libgif": "MIT",
    "libgomp": "GPL-3.0-or-later WITH GCC-exception-3.1",
    "libharfbuzz": "MIT-Modern-Variant",
    "libhdf5": "HDF5",
    "libhdf5_hl": "HDF5",
    "libjpeg": "IJG",
    "libjson-c": "MIT",
    "liblcms2": "MIT",
    "libllvmlite": "BSD-2-Clause AND Apache-2.0 WITH LLVM-exception",
    "liblzma": "0BSD",
    "libnetcdf": "BSD-3-Clause",
    "libnghttp2": "MIT",
    "libopenjp2": "BSD-2-Clause",
    "libpcre2-8": "BSD-3-Clause WITH PCRE2-exception",
    "libpng16": "libpng-2.0",
    "libproj": "MIT",
    "libquadmath": "LGPL-2.1-or-later",
    "libscipy_openblas": "BSD-3-Clause AND BSD-3-Clause-Open-MPI",
    "libscipy_openblas64_": "BSD-3-Clause AND BSD-3-Clause-Open-MPI",
    "libsharpyuv": "BSD-3-Clause",
    "libsqlite3": "blessing",
    "libssl": "Apache-2.0",
    "libsz": "BSD-2-Clause",
    "libtbb": "Apache-2.0",
    "libtiff": "libtiff",
    "libwebp": "BSD-3-Clause",
    "libwebpdemux": "BSD-3-Clause",
    "libwebpmux": "BSD-3-Clause",
    "libxcb": "MIT",
    "libzstd": "BSD-3-Clause OR GPL-2.0-only",
    "node": "MIT",
    "open3d_tf_ops": "MIT",
    "open3d_torch_ops": "MIT",
    "rnx2crx": "LicenseRef-RNXCMP",
    "ruff": "MIT",
}
"""SPDX expression of each bundled library or program, read from its own licence file."""
SEPARATE_FILE = (
    "unchanged, in a file of its own that the user may replace with another version; its source is public"
)
BUNDLED_FOLDERS = {"apsw/sqlite_extra_binaries": "blessing"}
"""The same for folders of many small ones: extensions of SQLite, which are in the public domain as SQLite is."""
CONDITIONS = {
    "GPL-3.0-or-later WITH GCC-exception-3.1": "the runtime library exception permits programs of any licence",
    "LGPL-2.1-only": SEPARATE_FILE,
    "LGPL-2.1-or-later": SEPARATE_FILE,
    # Terms are in hatanaka's LICENSE file.
    "LicenseRef-RNXCMP": "may be redistributed; a user who modifies or embeds it cites Hatanaka (2008)",
}
"""Licences that need a reason to be shipped; all others in BUNDLED are permissive."""
_IMPORTED = re.compile(r"\.py[ci]?$|\.(abi3|cpython-[^.]+)\.so$")


class BundledFile(NamedTuple):
    """A library or program inside a package; `licence` is an SPDX expression or None if it was not reviewed."""

    package: str
    path: str
    name: str
    licence: str | None


def bundled_files(distribution: Distribution) -> list[BundledFile]:
    """Return machine code in files of its own, without the modules that Python imports."""
    files = []
    for file in distribution.files or ():
        if not _IMPORTED.search(file.name) and _is_machine_code(Path(str(file.locate()))):
            # auditwheel appends a hash: libz-3a2b1c0d.so.1 is libz
            name = re.sub(r"(-[0-9a-f]{8})+$", "", file.name.partition(".so")[0])
            licence = BUNDLED_FOLDERS.get(file.parent.as_posix(), BUNDLED.get(name))
            files.append(BundledFile(distribution.name, str(file), name, licence))
    return sorted(files)


def main(installed: Iterable[Distribution] | None = None) -> int:
    """Print every bundled file with its licence; 1 where one has not been reviewed."""
    files = [file for each in installed or distributions() for file in bundled_files(each)]
    for file in files:
        condition = CONDITIONS.get(file.licence or "")
        print(f"{file.package:<24} {file.name:<28} {file.licence}{f': {condition}' if condition else ''}")
    unknown = [file for file in files if file.licence is None]
    for file in unknown:
        print(
            f"licences: {file.package}: {file.path}: licence unknown, expected an entry in BUNDLED",
            file=sys.stderr,
        )
    return int(bool(unknown))


def _is_machine_code(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(4) == b"\x7fELF"
    except OSError:  # an image leaves files out
        return False


if __name__ == "__main__":
    raise SystemExit(main())
