"""Bill of materials, licences and known vulnerabilities of what is installed here."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from email.message import Message
from http.server import BaseHTTPRequestHandler, HTTPServer
from importlib.metadata import Distribution
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from support.running import free_port
from support.tree import ROOT


def _loaded() -> Any:
    spec = importlib.util.spec_from_file_location("supply_chain", ROOT / "deploy" / "supply_chain.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["supply_chain"] = module
    spec.loader.exec_module(module)
    return module


tool = _loaded()
PINS = {
    tool.canonical(name): version
    for name, version in re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), re.M)
}


def distribution(**fields: str | list[str]) -> Any:
    metadata = Message()
    metadata["Name"] = "something"
    for name, value in fields.items():
        for each in value if isinstance(value, list) else [value]:
            metadata[name.replace("_", "-")] = each
    return SimpleNamespace(metadata=metadata)


def test_everything_that_is_installed_for_camber_is_pinned_as_it_is() -> None:
    packages = [each for each in tool.installed(without={"mutation"}) if each.name != "camber"]
    assert len(packages) > 60
    assert {each.name: PINS.get(each.name) for each in packages} == {
        each.name: each.version for each in packages
    }


def test_what_is_shipped_is_without_the_tools_of_development() -> None:
    names = {each.name for each in tool.installed()}
    assert {"camber", "numpy", "numba", "open3d", "asyncpg", "prometheus-client"} <= names
    assert not names & {"pytest", "hypothesis", "mypy", "ruff", "mutmut", "pip"}


def test_what_is_shipped_has_licences_that_may_be(capsys: pytest.CaptureFixture[str]) -> None:
    assert tool.main(["licences"]) == 0, capsys.readouterr().err


@pytest.mark.parametrize(
    ("expression", "may"),
    [
        ("MIT", True),
        ("GPL-3.0-only", False),
        ("AGPL-3.0-or-later", False),
        ("LGPL-2.1-only", False),
        (None, False),
        ("MIT OR GPL-3.0-only", True),
        ("MIT AND GPL-3.0-only", False),
        ("MIT AND (GPL-2.0-only OR BSD-3-Clause)", True),
        ("(MIT AND GPL-2.0-only) OR GPL-3.0-only", False),
        ("BSD-2-Clause AND Apache-2.0 WITH LLVM-exception", True),
        ("GPL-3.0-only WITH GCC-exception-3.1", False),
        ("MIT BSD-3-Clause", False),
        ("MIT AND", False),
        ("MIT OR", False),
        ("MIT OR )", False),
        ("(MIT OR", False),
        ("MIT OR (MIT", False),
        ("OR MIT", False),
        ("(MIT", False),
        ("LicenseRef-Proprietary", False),
    ],
)
def test_of_or_one_side_must_be_allowed_and_of_and_both(expression: str | None, may: bool) -> None:
    assert tool.may_ship(expression) is may


@pytest.mark.parametrize(
    ("fields", "licence"),
    [
        ({"License_Expression": "MIT", "License": "GPL"}, "MIT"),
        ({"Classifier": ["License :: OSI Approved :: BSD License"]}, "BSD-3-Clause"),
        (
            {"Classifier": ["License :: OSI Approved :: MIT License",
                            "License :: OSI Approved :: GNU General Public License v3 (GPLv3)"]},
            "GPL-3.0-only AND MIT",
        ),
        ({"Classifier": ["License :: OSI Approved :: Something new"], "License": "MIT"}, None),
        ({"License": "Apache 2.0"}, "Apache-2.0"),
        ({"License": "MPL-2.0 AND MIT"}, "MPL-2.0 AND MIT"),
        ({"License": "GPLv3"}, None),
        ({"License": "UNKNOWN"}, None),
        ({"License": "UNKNOWN", "Classifier": ["License :: OSI Approved :: MIT License"]}, "MIT"),
        ({"License": "BSD-2-Clause", "Classifier": ["License :: OSI Approved :: BSD License"]}, "BSD-2-Clause"),
        ({"License": "LGPL-3.0-only", "Classifier": ["License :: OSI Approved :: MIT License"]}, None),
        ({"License": "BSD-4-Clause", "Classifier": ["License :: OSI Approved :: BSD License"]}, None),
        ({"License": "Apache-2.0", "Classifier": ["License :: OSI Approved :: MIT License"]}, None),
        ({"License": "Permission is\n  granted", "Classifier": ["License :: OSI Approved :: MIT License"]}, "MIT"),
        ({"License": "GNU GENERAL\n  PUBLIC", "Classifier": ["License :: OSI Approved :: MIT License"]}, None),
        ({}, None),
    ],
)  # fmt: skip
def test_a_licence_is_what_the_metadata_say_and_never_a_guess(
    fields: dict[str, Any], licence: str | None
) -> None:
    assert tool.licence_of(distribution(**fields)) == licence


def test_a_package_that_may_not_be_shipped_fails_and_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = [tool.Package("copyleft", "1.0", "GPL-3.0-only", ()), tool.Package("mystery", "2.0", None, ())]
    monkeypatch.setattr(tool, "installed", lambda: [tool.Package("camber", "0.1.0", "Apache-2.0", ()), *bad])
    assert tool.main(["licences"]) == 1
    said = capsys.readouterr().err
    assert "copyleft 1.0: GPL-3.0-only" in said
    assert "mystery 2.0: unknown" in said


ELF = b"\x7fELF"
RECORD = {
    "wheel/__init__.py": b"",
    "wheel/_core.cpython-311-x86_64-linux-gnu.so": ELF,
    "wheel/_core.abi3.so": ELF,
    "wheel/table.bin": b"table",
    "wheel/tool": ELF,
    "wheel.libs/libgeos-1269e1bd.so.3.14.1": ELF,
    "wheel.libs/libglib-2.0-040039e1-0352e75f.so.0": ELF,
    "wheel.libs/libgone-1269e1bd.so.3": None,
}


@pytest.fixture
def wheel(tmp_path: Path) -> Any:
    """An installed package with its own modules, two libraries and a program of others, and one file that is gone."""
    for name, content in RECORD.items():
        if content is not None:
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_bytes(content)
    info = tmp_path / "wheel-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.4\nName: wheel\nVersion: 1.0\nLicense-Expression: MIT\n"
    )
    (info / "RECORD").write_text("".join(f"{name},,\n" for name in RECORD))
    return Distribution.at(info)


def test_what_a_package_brings_of_others_is_found_by_its_name(wheel: Any) -> None:
    assert [(each.name, each.licence) for each in tool.bundled_in(wheel)] == [
        ("libgeos", "LGPL-2.1-only"),
        ("libglib-2.0", None),
        ("tool", None),
    ]


def test_a_library_that_nobody_has_read_the_licence_of_fails_and_is_named(
    wheel: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    package = tool.Package("wheel", "1.0", "MIT", (), tool.bundled_in(wheel))
    monkeypatch.setattr(tool, "installed", lambda: [package])
    assert tool.main(["licences"]) == 1
    said = capsys.readouterr()
    assert "wheel 1.0: wheel.libs/libglib-2.0-040039e1-0352e75f.so.0: unknown" in said.err
    assert "wheel 1.0: wheel/tool: unknown" in said.err
    assert "libgeos" not in said.err
    assert re.search("libgeos +LGPL-2.1-only: unchanged", said.out)


def test_every_licence_that_was_read_is_one_that_may_be_shipped_in_a_file_of_its_own_or_as_a_package() -> (
    None
):
    assert [
        name for name, licence in tool.BUNDLED.items() if not tool.Bundled("", name, licence).shippable
    ] == []
    assert not [licence for licence in tool.ALLOWED_BUNDLED if tool.may_ship(licence)], "said twice"
    assert not tool.Bundled("", "libreadline", "GPL-3.0-or-later").shippable


def test_the_bill_is_the_same_each_time_and_names_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    for name in ("a", "b"):
        assert tool.main(["sbom", "--out", str(tmp_path / name)]) == 0
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    bill = json.loads((tmp_path / "a").read_text())
    assert (bill["bomFormat"], bill["specVersion"], bill["version"]) == ("CycloneDX", "1.6", 1)
    assert re.fullmatch(r"urn:uuid:[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", bill["serialNumber"])
    assert bill["metadata"]["timestamp"] == "2023-11-14T22:13:20Z"
    refs = [bill["metadata"]["component"]["bom-ref"], *(each["bom-ref"] for each in bill["components"])]
    assert len(set(refs)) == len(refs) == len(tool.installed())
    assert sorted(each["ref"] for each in bill["dependencies"]) == sorted(refs)
    assert all(set(each["dependsOn"]) <= set(refs) for each in bill["dependencies"])
    parts = {part["bom-ref"]: part for each in bill["components"] for part in each.get("components", ())}
    assert len(parts) == sum(len(each.bundled) for each in tool.installed()) > 30
    assert not parts.keys() & set(refs)
    assert {"LGPL-2.1-only"} <= {part["licenses"][0]["expression"] for part in parts.values()}
    zenoh = next(each for each in bill["components"] if each["name"] == "eclipse-zenoh")
    assert zenoh["purl"] == f"pkg:pypi/eclipse-zenoh@{PINS['eclipse-zenoh']}"
    (camber,) = [each for each in bill["dependencies"] if each["ref"] == refs[0]]
    assert zenoh["bom-ref"] in camber["dependsOn"]


def test_without_a_date_it_has_none(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    assert tool.main(["sbom"]) == 0
    assert "timestamp" not in json.loads(capsys.readouterr().out)["metadata"]


@contextmanager
def osv(answer: Any) -> Iterator[str]:
    """A server with the interface of OSV."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            asked = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            body = json.dumps(answer(asked)).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: Any) -> None:
            return

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def known_in(purl_part: str) -> Any:
    def answer(asked: dict[str, Any]) -> dict[str, Any]:
        purls = [query["package"]["purl"] for query in asked["queries"]]
        return {"results": [{"vulns": [{"id": "PYSEC-1"}]} if purl_part in purl else {} for purl in purls]}

    return answer


def test_a_known_vulnerability_fails_and_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with osv(known_in("/msgpack@")) as url:
        monkeypatch.setenv("OSV_URL", url)
        assert tool.main(["vulnerabilities"]) == 1
        assert f"pkg:pypi/msgpack@{PINS['msgpack']}: PYSEC-1" in capsys.readouterr().err
    with osv(known_in("/nothing@")) as url:
        monkeypatch.setenv("OSV_URL", url)
        assert tool.main(["vulnerabilities"]) == 0
    assert re.fullmatch(r"vulnerabilities: 0 of \d+ packages have known ones\n", capsys.readouterr().out)


def test_a_vulnerability_on_a_later_page_is_found_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def answer(asked: dict[str, Any]) -> dict[str, Any]:
        """msgpack has a page with one vulnerability, then one with another; zstandard has a first one alone."""
        results = []
        for query in asked["queries"]:
            page = query.get("page_token")
            if "/msgpack@" in query["package"]["purl"]:
                ids = {None: ["PYSEC-1"], "second": [], "third": ["PYSEC-2"]}[page]
                following = {None: {"next_page_token": "second"}, "second": {"next_page_token": "third"}}
                results.append({"vulns": [{"id": each} for each in ids], **following.get(page, {})})
            else:
                assert page is None
                results.append(
                    {"vulns": [{"id": "PYSEC-3"}]} if "/zstandard@" in query["package"]["purl"] else {}
                )
        return {"results": results}

    with osv(answer) as url:
        monkeypatch.setenv("OSV_URL", url)
        assert tool.main(["vulnerabilities"]) == 1
    said = capsys.readouterr()
    assert f"pkg:pypi/msgpack@{PINS['msgpack']}: PYSEC-1, PYSEC-2" in said.err
    assert f"pkg:pypi/zstandard@{PINS['zstandard']}: PYSEC-3" in said.err
    assert said.out.startswith("vulnerabilities: 2 of ")


def of_each(result: Any) -> Any:
    return lambda asked: {"results": [result] * len(asked["queries"])}


@pytest.mark.parametrize(
    "answer",
    [
        None,  # there is no server
        lambda _: {"results": []},
        lambda _: {},
        lambda _: [],
        *map(
            of_each,
            [
                None,
                "",
                [],
                {"error": "x"},
                {"vulns": None},
                {"vulns": "x"},
                {"vulns": [{}]},
                {"next_page_token": "x"},
            ],
        ),
    ],
)
def test_where_nobody_can_tell_it_says_skipped_and_fails_only_if_it_is_required(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], answer: Any
) -> None:
    with osv(answer) if answer else nullcontext(f"http://127.0.0.1:{free_port()}") as url:
        monkeypatch.setenv("OSV_URL", url)
        assert tool.main(["vulnerabilities"]) == 0
        assert "SKIPPED, nothing was checked" in capsys.readouterr().err
        assert tool.main(["vulnerabilities", "--required"]) == 1
