"""Joining over TLS is all or nothing, and what is wrong with a file is one line that names it and no secret."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from camber.runtime import access_probe, router
from camber.runtime.session import BusError, open_session, router_endpoints
from camber.runtime.settings import ConfigError, ServiceSettings, ZenohSettings, load, to_toml
from camber.runtime.tls_certificates import (
    TlsError,
    certificate_name,
    check_table,
    ends_soon,
    name_of,
    tls_table,
)
from camber.tools.security.certificate_authority import Authority

TLS = 'tls_ca = "a.pem"\ntls_certificate = "b.pem"\ntls_key = "b.key"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    now = datetime.now(UTC)
    authority = Authority.make(tmp_path / "pki", name="ours", days=30, now=now)
    authority.issue("car-1", "vehicle", days=20, now=now)
    authority.issue("car-2", "vehicle", days=20, now=now)
    authority.issue("late", "vehicle", days=1, now=now - timedelta(days=2))
    authority.issue("early", "vehicle", days=1, now=now + timedelta(days=1))
    Authority.make(tmp_path / "theirs", name="theirs", days=30, now=now)
    return tmp_path / "pki"


def certificates(folder: Path) -> dict[str, Any]:
    return {
        "tls_ca": folder / "ca.pem",
        "tls_certificate": folder / "car-1.pem",
        "tls_key": folder / "car-1.key",
    }


def table_of(folder: Path) -> dict[str, Any]:
    return tls_table(*certificates(folder).values())


def read(tmp_path: Path, zenoh: str) -> ZenohSettings:
    path = tmp_path / "service.toml"
    path.write_text(f"[zenoh]\n{zenoh}")
    return load(ServiceSettings, ["--config", str(path)], prog="camber x")[0].zenoh


@pytest.mark.parametrize(
    ("zenoh", "why"),
    [
        ('mode = "client"\nconnect = ["tls/c:1"]\ntls_ca = "a.pem"\n', "expected all three or none"),
        (f'mode = "client"\nconnect = ["tcp/c:1"]\n{TLS}', "expected only endpoints tls/"),
        (f'mode = "client"\nconnect = ["tls/c:1", "tcp/c:2"]\n{TLS}', "expected only endpoints tls/"),
        (f'mode = "peer"\nconnect = ["tls/c:1"]\n{TLS}', 'expected "client", got "peer"'),
        ('mode = "client"\nconnect = ["tls/c:1"]\n', "needs tls_ca, tls_certificate and tls_key"),
        ('mode = "client"\nconnect = ["quic/c:1"]\n', "needs tls_ca, tls_certificate and tls_key"),
    ],
    ids=["one file", "in the clear", "also in the clear", "as a peer", "tls without", "quic without"],
)
def test_half_of_tls_is_refused_in_one_line(tmp_path: Path, zenoh: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why) as refused:
        read(tmp_path, zenoh)
    assert "zenoh" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_all_of_tls_is_taken_and_printed_as_paths(tmp_path: Path) -> None:
    settings = read(tmp_path, f'mode = "client"\nconnect = ["tls/c:1"]\n{TLS}')
    assert settings.over_tls
    assert 'tls_key = "b.key"' in to_toml(settings)
    assert not ZenohSettings().over_tls


def test_a_good_table_passes_and_makes_both_sides_show_their_certificates(folder: Path) -> None:
    table = table_of(folder)
    check_table(table)
    assert certificate_name(folder / "car-1.pem") == "car-1"
    assert table["enable_mtls"]
    assert table["verify_name_on_connect"]
    assert table["close_link_on_expiration"]


def cut_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100])


@pytest.mark.parametrize("name", ["ca.pem", "car-1.pem", "car-1.key"])
@pytest.mark.parametrize(("harm", "why"), [(Path.unlink, "No such file"), (cut_off, "not a ")])
def test_a_file_that_is_missing_or_damaged_is_named(
    folder: Path, name: str, harm: Callable[[Path], None], why: str
) -> None:
    secret = (folder / "car-1.key").read_text().splitlines()[1]
    harm(folder / name)
    settings = ZenohSettings(mode="client", connect=["tls/127.0.0.1:1"], **certificates(folder))
    with pytest.raises(BusError, match=why) as refused:
        open_session(settings, timeout_s=1.0)
    assert str(folder / name) in str(refused.value)
    assert "\n" not in str(refused.value)
    assert secret not in str(refused.value)


@pytest.mark.parametrize(
    ("ca", "certificate", "key", "why"),
    [
        ("pki/ca.pem", "late.pem", "late.key", "late.pem: expired"),
        ("pki/ca.pem", "early.pem", "early.key", "early.pem: not valid before .* clock"),
        ("pki/ca.pem", "car-1.pem", "car-2.key", "car-2.key: not the key of "),
        ("theirs/ca.pem", "car-1.pem", "car-1.key", "car-1.pem: not signed by "),
    ],
)
def test_a_certificate_that_will_not_be_taken_is_reported_before_it_is_tried(
    folder: Path, ca: str, certificate: str, key: str, why: str
) -> None:
    with pytest.raises(TlsError, match=why):
        check_table(tls_table(folder.parent / ca, folder / certificate, folder / key))


def test_a_router_listens_on_the_loopback_unless_it_is_configured_otherwise(tmp_path: Path) -> None:
    empty, configured = tmp_path / "empty.json5", tmp_path / "configured.json5"
    empty.write_text("{}")
    configured.write_text('{mode: "router", listen: {endpoints: ["tcp/127.0.0.2:1"]}}')
    assert router_endpoints(None)[0] == ["tcp/127.0.0.1:7447"]
    assert router_endpoints(empty)[0] == ["tcp/127.0.0.1:7447"]
    assert router_endpoints(configured)[0] == ["tcp/127.0.0.2:1"]
    assert router_endpoints(configured, listen=["tcp/127.0.0.3:1"])[0] == ["tcp/127.0.0.3:1"]


@pytest.mark.parametrize("mode", ["client", "router"])
def test_a_vehicles_router_goes_on_without_its_certificate_and_the_clouds_does_not(
    folder: Path, tmp_path: Path, mode: str
) -> None:
    file = tmp_path / "router.json5"
    for ca, name in (("pki", "late"), ("pki", "early"), ("pki", "none"), ("theirs", "car-1")):
        table = tls_table(folder.parent / ca / "ca.pem", folder / f"{name}.pem", folder / f"{name}.key")
        file.write_text(json.dumps({"mode": mode, "transport": {"link": {"tls": table}}}))
        with nullcontext() if mode == "client" else pytest.raises(BusError, match=f"{name}.pem: "):
            assert router_endpoints(file)[2]["root_ca_certificate"] == table["root_ca_certificate"]


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:9", "unixsock-stream//tmp/cloud.sock"])
def test_a_vehicles_router_with_rules_takes_no_link_that_they_would_count_as_within(
    tmp_path: Path, endpoint: str
) -> None:
    file, rules = tmp_path / "vehicle.json5", {"enabled": True, "default_permission": "deny"}
    file.write_text(json.dumps({"mode": "client", "access_control": rules}))
    assert router_endpoints(file, connect=["quic/cloud.example:1"])[1] == ["quic/cloud.example:1"]
    with pytest.raises(BusError, match=f"expected tls/ or quic/ beside access rules, got {endpoint}"):
        router_endpoints(file, connect=[endpoint])


def test_what_ends_within_two_weeks_is_reported(folder: Path) -> None:
    table, now = tls_table(folder / "ca.pem", folder / "car-1.pem", folder / "none"), datetime.now(UTC)
    assert ends_soon(table, now) == []
    (message,) = ends_soon(table, now + timedelta(days=7))
    assert message.startswith(f"{folder / 'car-1.pem'}: until ")
    assert len(ends_soon(table, now + timedelta(days=25))) == 2
    (folder / "car-1.pem").unlink()
    assert len(ends_soon(table, now + timedelta(days=25))) == 1


def test_a_service_is_alerted_whenever_it_is_denied_again(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter(["permitted", "denied", "permitted", "denied"])

    def ask(*_: object, **__: object) -> str:
        # It asks for ever, and this is enough.
        return next(answers, "") or str(threading.Event().wait())

    monkeypatch.setattr(access_probe, "can_publish", ask)
    monkeypatch.setattr(access_probe, "denial_message", lambda *_: "denied")
    problems: list[str] = []
    watch = access_probe.AccessProbe(ZenohSettings(), "fleet", again_s=0.01)
    deadline = time.monotonic() + 5.0
    while len(problems) < 2 and time.monotonic() < deadline:
        problems += watch.problems()
        time.sleep(0.01)
    assert problems == ["denied", "denied"]


def test_the_link_is_asked_about_at_the_router_that_it_goes_to(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lists = {"tls/a:1": ("A", "permitted"), "tls/b:1": ("B", "denied")}

    def ask(settings: ZenohSettings, _: str, *, at: frozenset[str], **__: float) -> str:
        (endpoint,) = settings.connect
        zid, answer = lists[endpoint]
        if at and zid not in at:
            raise BusError(f"{endpoint}: another")
        return answer

    monkeypatch.setattr(access_probe, "can_publish", ask)
    settings = ZenohSettings(mode="client", connect=list(lists), **certificates(folder))

    def asked(name: str | None, *linked: str) -> tuple[str, str | None]:
        return router._access_status(settings, name, frozenset(linked))

    assert asked("x", "A") == ("accepted as x at tls/a:1", "tls/a:1")
    assert asked("x") == ("no link, though tls/a:1 would accept x", "tls/a:1")
    for name, linked, begin in (
        (None, "B", "tls/b:1 lets nothing pass that car-1 says as car-1"),
        ("x", "C", "no link: tls/a:1: another; "),
    ):
        status, by = asked(name, linked)
        assert status.startswith(begin)
        assert by is None


def test_a_link_that_goes_to_another_router_is_asked_about_anew(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    looks, asked = iter("AABBB"), []

    class Session:
        info = SimpleNamespace(routers_zid=lambda: [next(looks)], peers_zid=list)

    def ask(_: ZenohSettings, __: str | None, linked: frozenset[str]) -> tuple[str, str]:
        asked.append(linked)
        return f"accepted at {min(linked)}", min(linked)

    monkeypatch.setattr(router.zenoh, "Session", Session)
    monkeypatch.setattr(router, "_access_status", ask)
    monkeypatch.setattr(router, "_LOOK_S", 0.0)
    with pytest.raises(StopIteration):
        router._watch([Session()], ["tls/a:1"], table_of(folder), [], begin_anew=pytest.fail)
    assert asked == [{"A"}, {"B"}]
    assert capsys.readouterr().err.splitlines() == [
        "camber router: accepted at A",
        "camber router: accepted at B",
    ]


def test_a_vehicles_name_is_that_of_its_rules() -> None:
    def rules(*names: str) -> list[dict[str, object]]:
        return [{"key_exprs": [f"camber/v1/{name}/echo", "camber/v1/y/x/verdict"]} for name in names]

    assert access_probe.name_in(rules("car-9", "car-9")) == "car-9"
    assert access_probe.name_in(rules("car-1", "car-2")) is None
    assert access_probe.name_in(rules("*")) is None


@pytest.mark.parametrize(
    ("common_name", "name"), [("car-1", "car-1"), ("car-1+2", "car-1"), ("car+x", "car+x"), ("a+1+12", "a+1")]
)
def test_a_common_name_stands_for_a_name(common_name: str, name: str) -> None:
    assert name_of(common_name) == name


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('{ transport: { auth: { usrpwd: { user: "a", password: "SECRET" } }, nonsense', "line 1, column"),
        ('{ transport: { auth: { usrpwd: { user: "a", password: ["SECRET"] } } } }', "line 1, column"),
        ('{ transport: { auth: { usrpwd: { passwrd: "SECRET" } } } }', "unknown field `passwrd`"),
        ('{ mode: "SECRET" }', "not a configuration of Zenoh"),
        (None, "No such file"),
    ],
    ids=["not closed", "of a wrong kind", "misspelt", "no mode", "not there"],
)
def test_a_configuration_that_is_wrong_is_one_line_without_what_stands_in_it(
    tmp_path: Path, text: str | None, why: str
) -> None:
    path = tmp_path / "zenoh.json5"
    if text is not None:
        path.write_text(text)
    with pytest.raises(BusError, match=why) as refused:
        router_endpoints(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert "SECRET" not in str(refused.value)
    assert "\n" not in str(refused.value)
