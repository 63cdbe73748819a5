"""What Camber is made of: a bill of materials, its licences, its known vulnerabilities; from what is installed here.

    supply_chain.py sbom [--out FILE]    CycloneDX 1.6, JSON; the same bytes for the same packages
    supply_chain.py licences             fails on a licence that Camber must not ship, or that nobody can tell; of
                                         packages, and of libraries and programs within them
    supply_chain.py vulnerabilities      asks OSV (https://osv.dev); says SKIPPED where that cannot be reached

It covers what the images install: camber with all extras but those for development. Where `packaging` is not installed,
as in an image, that is everything there. `SOURCE_DATE_EPOCH` dates the bill; without it, it has no date. `OSV_URL` is
another server with the interface of OSV.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import urllib.error
import urllib.request
import uuid
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any

NOT_SHIPPED = frozenset({"dev", "mutation"})
"""Extras of camber that no image installs."""
INSTALLERS = frozenset({"pip", "setuptools", "wheel"})
"""They make an environment, and are no part of what runs."""

ALLOWED = frozenset(
    {
        "0BSD",
        "Apache-2.0",
        "Apache-2.0 WITH LLVM-exception",
        "BSD-2-Clause",
        "BSD-3-Clause",
        "BSD-3-Clause WITH PCRE2-exception",
        "BSD-3-Clause-Open-MPI",
        "CC0-1.0",
        "HDF5",
        "HPND",
        "IJG",
        "ISC",
        "MIT",
        "MIT-0",
        "MPL-2.0",  # of files: what uses them unchanged owes nothing
        "PSF-2.0",
        "Python-2.0",
        "Unlicense",
        "Zlib",
        "blessing",
        "curl",
        "libpng-2.0",
        "libtiff",
    }
)
REVIEWED = {
    # Its classifiers name both; its licence file says that the user chooses.
    "eclipse-zenoh": "Apache-2.0 OR EPL-2.0",
}
"""Where the metadata do not say it: read by a person, in the package's own licence file."""

BUNDLED = {
    "crx2rnx": "LicenseRef-RNXCMP",
    "libLerc": "Apache-2.0",
    "libOpen3D": "MIT",
    "libaec": "BSD-2-Clause",
    "libblosc": "BSD-3-Clause",
    "libcrypto": "Apache-2.0",
    "libcurl": "curl",
    "libdeflate": "MIT",
    "libgdal": "MIT",
    "libgeos": "LGPL-2.1-only",
    "libgeos_c": "LGPL-2.1-only",
    "libgfortran": "GPL-3.0-or-later WITH GCC-exception-3.1",
    "libgif": "MIT",
    "libgomp": "GPL-3.0-or-later WITH GCC-exception-3.1",
    "libhdf5": "HDF5",
    "libhdf5_hl": "HDF5",
    "libjpeg": "IJG",
    "libjson-c": "MIT",
    "libllvmlite": "BSD-2-Clause AND Apache-2.0 WITH LLVM-exception",
    "liblzma": "0BSD",
    "libnetcdf": "BSD-3-Clause",
    "libnghttp2": "MIT",
    "libopenjp2": "BSD-2-Clause",
    "libpcre2-8": "BSD-3-Clause WITH PCRE2-exception",
    "libpng16": "libpng-2.0",
    "libproj": "MIT",
    "libquadmath": "LGPL-2.1-or-later",
    "libscipy_openblas64_": "BSD-3-Clause AND BSD-3-Clause-Open-MPI",
    "libsharpyuv": "BSD-3-Clause",
    "libsqlite3": "blessing",
    "libssl": "Apache-2.0",
    "libsz": "BSD-2-Clause",
    "libtbb": "Apache-2.0",
    "libtiff": "libtiff",
    "libwebp": "BSD-3-Clause",
    "libzstd": "BSD-3-Clause OR GPL-2.0-only",
    "open3d_tf_ops": "MIT",
    "open3d_torch_ops": "MIT",
    "rnx2crx": "LicenseRef-RNXCMP",
}
"""Libraries and programs that wheels hold in files of their own, by their own licence: the metadata need not say it."""
_REPLACEABLE = (
    "unchanged, a file of its own that anybody may put another version in the place of; its source is public"
)
ALLOWED_BUNDLED = {
    "GPL-3.0-or-later WITH GCC-exception-3.1": "the exception: what runs with GCC's own libraries may have any licence",
    "LGPL-2.1-only": _REPLACEABLE,
    "LGPL-2.1-or-later": _REPLACEABLE,
    # hatanaka's LICENSE file has the terms.
    "LicenseRef-RNXCMP": "may be passed on; whoever changes or combines it cites Hatanaka (2008)",
}
"""Licences that packages may not have, but such files: why they may be shipped all the same."""

_CLASSIFIERS = {
    "Apache Software License": "Apache-2.0",
    "BSD License": "BSD-3-Clause",
    "Eclipse Public License 2.0 (EPL-2.0)": "EPL-2.0",
    "GNU Affero General Public License v3": "AGPL-3.0-only",
    "GNU General Public License (GPL)": "GPL-1.0-or-later",
    "GNU General Public License v2 (GPLv2)": "GPL-2.0-only",
    "GNU General Public License v3 (GPLv3)": "GPL-3.0-only",
    "GNU Lesser General Public License v3 (LGPLv3)": "LGPL-3.0-only",
    "ISC License (ISCL)": "ISC",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
    "The Unlicense (Unlicense)": "Unlicense",
}
_WORDS = {
    "apache 2": "Apache-2.0",
    "apache 2.0": "Apache-2.0",
    "apache license 2.0": "Apache-2.0",
    "bsd": "BSD-3-Clause",
    "bsd 2-clause license": "BSD-2-Clause",
    "bsd 3-clause license": "BSD-3-Clause",
    "isc license": "ISC",
    "mit license": "MIT",
    "new bsd": "BSD-3-Clause",
}
_IMPORTED = re.compile(r"\.py[ci]?$|\.(abi3|cpython-[^.]+)\.so$")
_OSV = "https://api.osv.dev"
_TIMEOUT_S = 20.0
_MOST_PAGES = 100


@dataclass(frozen=True, slots=True)
class Bundled:
    """A library or program within a package; `licence` is an SPDX expression, None: nobody has read it."""

    path: str
    name: str
    licence: str | None

    @property
    def shippable(self) -> bool:
        """Is its licence one that packages may have, or one that such a file may have?"""
        return self.licence in ALLOWED_BUNDLED or may_ship(self.licence)


@dataclass(frozen=True, slots=True)
class Package:
    """One installed distribution; `licence` is an SPDX expression, None: nobody can tell."""

    name: str
    version: str
    licence: str | None
    needs: tuple[str, ...]
    bundled: tuple[Bundled, ...] = ()

    @property
    def purl(self) -> str:
        """As package URLs are written."""
        return f"pkg:pypi/{self.name}@{self.version}"


def canonical(name: str) -> str:
    """The name by which a package is known, however it is spelt."""
    return re.sub(r"[-_.]+", "-", name).lower()


def installed(without: Iterable[str] = NOT_SHIPPED) -> list[Package]:
    """camber's requirements with all its extras but these, and theirs, as installed here; camber first."""
    here = {canonical(each.metadata["Name"]): each for each in distributions()}
    if "camber" not in here:
        raise SystemExit("camber is not installed here: make setup")
    needs = _closure(here, frozenset(without))
    first = ["camber", *sorted(needs.keys() - {"camber"})]
    return [_package(name, here[name], needs[name]) for name in first]


def licence_of(distribution: Distribution) -> str | None:
    """SPDX, by the metadata: expression, else `License` and classifiers (all of them hold) where they agree."""
    metadata: Any = distribution.metadata
    name = canonical(metadata["Name"])
    if name in REVIEWED:
        return REVIEWED[name]
    if expression := metadata.get("License-Expression"):
        return str(expression)
    classifiers = [
        text.rpartition(" :: ")[2]
        for text in metadata.get_all("Classifier", [])
        if text.startswith("License ::")
    ]
    named = {_CLASSIFIERS.get(text) for text in classifiers if text != "OSI Approved"}
    text = (metadata.get("License") or "").strip()
    if "\n" in text and "GNU" not in text:  # the licence itself, which classifiers name
        text = ""
    word = _WORDS.get(text.lower(), text)
    if word not in ("", "UNKNOWN"):
        parts = set(re.split(r" (?:AND|OR) ", word))
        agree = not named or {_family(part) for part in parts} == {_family(str(each)) for each in named}
        return word if agree and parts <= ALLOWED else None
    return " AND ".join(sorted(map(str, named))) if named and None not in named else None


def bundled_in(distribution: Distribution) -> tuple[Bundled, ...]:
    """Machine code in files of its own: shared libraries and programs, without the modules that Python imports."""
    found = []
    for file in distribution.files or ():
        if not _IMPORTED.search(file.name) and _is_machine_code(Path(str(file.locate()))):
            # Without what tells it from others of its name: libz-3a2b1c0d.so.1 is libz.
            name = re.sub(r"(-[0-9a-f]{8})+$", "", file.name.partition(".so")[0])
            found.append(Bundled(str(file), name, BUNDLED.get(name)))
    return tuple(sorted(found, key=lambda each: each.path))


def may_ship(expression: str | None) -> bool:
    """Does an SPDX expression allow it? Of OR one side must, of AND both."""
    if expression is None:
        return False
    try:
        allowed, rest = _either(re.findall(r"\(|\)|[^\s()]+", expression))
    except _BrokenError:
        return False
    return allowed and not rest


def sbom(packages: Sequence[Package], made: datetime | None) -> dict[str, Any]:
    """CycloneDX 1.6."""
    camber, *others = packages
    refs = {package.name: package.purl for package in packages}
    body: dict[str, Any] = {
        "components": [_component(package, "library") for package in others],
        "dependencies": [
            {"ref": package.purl, "dependsOn": sorted(refs[name] for name in package.needs if name in refs)}
            for package in packages
        ],
    }
    metadata: dict[str, Any] = {"component": _component(camber, "application")}
    if made is not None:
        metadata["timestamp"] = made.strftime("%Y-%m-%dT%H:%M:%SZ")
    content = json.dumps([metadata, body], sort_keys=True)
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, content)}",
        "version": 1,
        "metadata": metadata,
        **body,
    }


def vulnerabilities(packages: Sequence[Package], server: str) -> dict[str, list[str]]:
    """purl → ids of known vulnerabilities. Raises OSError or ValueError where nobody can tell."""
    found: dict[str, set[str]] = {}
    queries: list[dict[str, Any]] = [{"package": {"purl": package.purl}} for package in packages]
    for _ in range(_MOST_PAGES):
        more = []
        for query, result in zip(queries, _ask_osv(queries, server), strict=True):
            # Anything else, an error for instance, would look as if nothing were known.
            if not isinstance(result, dict) or not result.keys() <= {"vulns", "next_page_token"}:
                raise ValueError(f"expected vulns and next_page_token alone, not {json.dumps(result)[:80]}")
            for vulnerability in result.get("vulns", []):
                found.setdefault(query["package"]["purl"], set()).add(str(vulnerability["id"]))
            if token := result.get("next_page_token"):
                more.append({**query, "page_token": token})
        if not more:
            return {purl: sorted(ids) for purl, ids in found.items()}
        queries = more
    raise ValueError(f"expected at most {_MOST_PAGES} pages")


def main(argv: Sequence[str] | None = None) -> int:
    """0 well, 1 something must not be shipped, 2 wrong usage."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    bill = commands.add_parser("sbom", help="bill of materials")
    bill.add_argument("--out", type=Path, metavar="FILE", help="default: standard output")
    commands.add_parser("licences", help="of all packages that are shipped")
    known = commands.add_parser("vulnerabilities", help="known ones")
    known.add_argument(
        "--required", action="store_true", help="fail, too, where the server cannot be reached"
    )
    args = parser.parse_args(argv)
    packages = installed()
    if args.command == "sbom":
        return _write_sbom(packages, args.out)
    if args.command == "licences":
        return _say_licences(packages)
    return _say_vulnerabilities(packages, os.environ.get("OSV_URL", _OSV), required=args.required)


def _write_sbom(packages: Sequence[Package], out: Path | None) -> int:
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    made = None if epoch is None else datetime.fromtimestamp(int(epoch), UTC)
    text = json.dumps(sbom(packages, made), indent=1, sort_keys=True) + "\n"
    if out is None:
        print(text, end="")
    else:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text, encoding="utf-8")
        print(f"{out}: {len(packages)} packages")
    return 0


def _say_licences(packages: Sequence[Package]) -> int:
    refused = [package for package in packages if not may_ship(package.licence)]
    unread = [(package, each) for package in packages for each in package.bundled if not each.shippable]
    for package in packages:
        print(f"{package.name:<28} {package.version:<14} {package.licence or 'UNKNOWN'}")
        for each in package.bundled:
            why = ALLOWED_BUNDLED.get(each.licence or "")
            print(f"  with {each.name:<36} {each.licence or 'UNKNOWN'}{f': {why}' if why else ''}")
    for package, each in unread:
        print(
            f"licences: {package.name} {package.version}: {each.path}: {each.licence or 'unknown'}: not one that may "
            "be shipped; another package, or BUNDLED in deploy/supply_chain.py with what its licence says",
            file=sys.stderr,
        )
    for package in refused:
        print(
            f"licences: {package.name} {package.version}: {package.licence or 'unknown'}: not one that may be shipped; "
            "another package, or REVIEWED in deploy/supply_chain.py with what its licence file says",
            file=sys.stderr,
        )
    return 1 if refused or unread else 0


def _say_vulnerabilities(packages: Sequence[Package], server: str, *, required: bool) -> int:
    others = [package for package in packages if package.name != "camber"]
    try:
        found = vulnerabilities(others, server)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        reason = getattr(error, "reason", error)
        print(f"vulnerabilities: SKIPPED, nothing was checked: {server}: {reason}", file=sys.stderr)
        return 1 if required else 0
    for purl, ids in sorted(found.items()):
        print(f"vulnerabilities: {purl}: {', '.join(ids)}", file=sys.stderr)
    print(f"vulnerabilities: {len(found)} of {len(others)} packages have known ones")
    return 1 if found else 0


def _package(name: str, distribution: Distribution, needs: Iterable[str]) -> Package:
    licence, bundled = licence_of(distribution), bundled_in(distribution)
    return Package(name, distribution.version, licence, tuple(sorted(needs)), bundled)


def _family(licence: str) -> str:
    """A classifier does not say which of the BSD licences it means."""
    return "BSD" if re.fullmatch(r"BSD-[23]-Clause", licence) else licence


def _is_machine_code(path: Path) -> bool:
    """By its first bytes; what an image leaves out is not there."""
    try:
        with path.open("rb") as stream:
            return stream.read(4) == b"\x7fELF"
    except OSError:
        return False


def _ask_osv(queries: Sequence[dict[str, Any]], server: str) -> list[Any]:
    """The result of each query."""
    request = urllib.request.Request(
        f"{server}/v1/querybatch",
        data=json.dumps({"queries": queries}).encode(),
        headers={"Content-Type": "application/json"},
    )
    with urllib.request.urlopen(request, timeout=_TIMEOUT_S) as answer:
        results = json.load(answer).get("results")
    if not isinstance(results, list) or len(results) != len(queries):
        raise ValueError(f"expected {len(queries)} results")
    return results


def _component(package: Package, kind: str) -> dict[str, Any]:
    component: dict[str, Any] = {
        "type": kind,
        "bom-ref": package.purl,
        "name": package.name,
        "version": package.version,
        "purl": package.purl,
    }
    if package.licence is not None:
        component["licenses"] = [{"expression": package.licence}]
    if package.bundled:
        component["components"] = [_part(package, each) for each in package.bundled]
    return component


def _part(package: Package, bundled: Bundled) -> dict[str, Any]:
    part: dict[str, Any] = {
        "type": "library",
        "bom-ref": f"{package.purl}#{bundled.path}",
        "name": bundled.name,
    }
    if bundled.licence is not None:
        part["licenses"] = [{"expression": bundled.licence}]
    return part


def _closure(here: dict[str, Distribution], without: frozenset[str]) -> dict[str, set[str]]:
    """Name → names it needs here, of all that camber needs."""
    try:
        from packaging.requirements import Requirement
    except ImportError:  # an image: all that is there runs there
        return {name: set() for name in here if name not in INSTALLERS}
    every = set(here["camber"].metadata.get_all("Provides-Extra", [])) - without
    wanted: dict[str, set[str]] = {"camber": every}
    needs: dict[str, set[str]] = {}
    queue = ["camber"]
    while queue:
        name = queue.pop()
        needs[name] = set()
        for line in here[name].requires or ():
            requirement = Requirement(line)
            other = canonical(requirement.name)
            extras = ["", *wanted[name]]
            marker = requirement.marker
            if marker is not None and not any(marker.evaluate({"extra": extra}) for extra in extras):
                continue
            if other not in here:
                raise SystemExit(f"{name} needs {other}, which is not installed here: make setup")
            needs[name].add(other)
            before = wanted.get(other)
            wanted[other] = (before or set()) | requirement.extras
            if before is None or wanted[other] != before:
                queue.append(other)
    return needs


class _BrokenError(Exception):
    """No expression: something is missing in it."""


def _either(tokens: list[str]) -> tuple[bool, list[str]]:
    allowed, rest = _all(tokens)
    while rest and rest[0] == "OR":
        other, rest = _all(rest[1:])
        allowed = allowed or other
    return allowed, rest


def _all(tokens: list[str]) -> tuple[bool, list[str]]:
    allowed, rest = _one(tokens)
    while rest and rest[0] == "AND":
        other, rest = _one(rest[1:])
        allowed = allowed and other
    return allowed, rest


def _one(tokens: list[str]) -> tuple[bool, list[str]]:
    if not tokens or tokens[0] in ("AND", "OR", "WITH", ")"):
        raise _BrokenError
    if tokens[0] == "(":
        allowed, rest = _either(tokens[1:])
        if rest[:1] != [")"]:
            raise _BrokenError
        return allowed, rest[1:]
    if tokens[1:2] == ["WITH"]:
        return " ".join(tokens[:3]) in ALLOWED, tokens[3:]
    return tokens[0] in ALLOWED, tokens[1:]


if __name__ == "__main__":
    raise SystemExit(main())
