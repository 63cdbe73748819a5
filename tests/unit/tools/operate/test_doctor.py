"""`camber doctor`: each check with a deployment that is well, and with its fault."""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from camber.formats.nmea.writer import format_gga, format_rmc
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.map_server.settings import MapServerSettings
from camber.runtime.clock import SystemClock
from camber.runtime.health.metrics import HealthCollector, MetricsServer
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.tools.operate import doctor as tool
from camber.tools.operate import doctor_machine_checks as checks
from camber.tools.operate.doctor_connection_checks import check_bus, check_map, check_ports, check_receiver
from camber.tools.operate.doctor_machine_checks import (
    ClockDiscipline,
    Finding,
    check_certificates,
    check_clock,
    check_folder,
)
from camber.tools.security.certificate_authority import Authority
from support.release_world import KEY
from support.running import free_port
from support.small_map import surface, write

NOW = datetime(2026, 6, 1, tzinfo=UTC)
TODAY = NOW.timestamp()
SYNCHRONISED = ClockDiscipline(synchronised=True, most_error_s=0.002, tai_minus_utc_s=37)


def states(findings: Iterable[Finding]) -> dict[str, str]:
    return {finding.what: finding.state for finding in findings}


def the_problem(findings: Iterable[Finding]) -> Finding:
    (result,) = [finding for finding in findings if finding.state == "problem"]
    assert result.todo
    return result


def test_a_disciplined_clock_is_ok_and_one_that_the_kernel_does_not_report_is_not_checked() -> None:
    assert states(check_clock(SYNCHRONISED, time.time())) == {"clock": "ok", "leap seconds": "ok"}
    assert states(check_clock(None, time.time())) == {"clock": "not checked"}


@pytest.mark.parametrize(
    ("fault", "unix_s", "expected"),
    [
        ({"synchronised": False, "most_error_s": 16.0}, TODAY, "not synchronised"),
        ({"most_error_s": 0.2}, TODAY, "up to 0.200 s off"),
        ({"tai_minus_utc_s": 36}, TODAY, "17 s for the kernel"),
        ({}, 100.0, "1970-01-01"),
    ],
)
def test_a_clock_with_a_fault_is_a_problem(fault: dict[str, Any], unix_s: float, expected: str) -> None:
    assert expected in the_problem(check_clock(replace(SYNCHRONISED, **fault), unix_s)).text


def test_the_kernel_reports_its_clock() -> None:
    discipline = checks.kernel_discipline()
    assert discipline is not None
    assert discipline.most_error_s >= 0.0
    assert discipline.tai_minus_utc_s in range(100)


def test_a_writable_folder_is_ok_and_nothing_is_left_in_it(tmp_path: Path) -> None:
    assert check_folder("disk", tmp_path, least_free_bytes=1).state == "ok"
    result = check_folder("disk", tmp_path / "a" / "b", least_free_bytes=1)
    assert (result.state, "will be created" in result.text) == ("ok", True)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_below_one_without_permission_is_a_problem(tmp_path: Path) -> None:
    private = tmp_path / "private"
    private.mkdir(mode=0o000)
    us = os.geteuid()
    if us == 0:
        os.seteuid(65534)
    try:
        result = check_folder("disk", private / "state", least_free_bytes=1)
    finally:
        os.seteuid(us)
    assert (result.state, "Permission denied" in result.text) == ("problem", True)


def test_what_is_wrong_with_a_disk_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "make room" in check_folder("disk", tmp_path, least_free_bytes=1 << 60).todo
    (tmp_path / "state").write_text("")
    assert check_folder("disk", tmp_path / "state" / "integrity").state == "problem"
    (tmp_path / "state").unlink()
    assert check_folder("disk", Path("/proc/camber")).state == "problem"
    with monkeypatch.context() as slow:
        times = iter([0.0, 2.0])
        slow.setattr(checks.time, "monotonic", lambda: next(times))
        assert "a flush took 2.0 s" in check_folder("disk", tmp_path, least_free_bytes=1).text
    monkeypatch.setattr(os, "fsync", Mock(side_effect=OSError(5, "Input/output error")))
    result = check_folder("disk", tmp_path, least_free_bytes=1)
    assert (result.state, "Input/output error" in result.text) == ("problem", True)
    assert list(tmp_path.iterdir()) == []


def pki(folder: Path, *, begins: datetime = NOW - timedelta(days=1), days: float = 365) -> dict[str, Path]:
    """An authority, and a certificate of it with its key, in files."""
    authority = Authority.make(folder, name="authority", days=3650, now=NOW - timedelta(days=300))
    authority.issue("car-1", "vehicle", days=days, now=begins)
    names = {"authority": "ca.pem", "certificate": "car-1.pem", "key": "car-1.key"}
    return {what: folder / name for what, name in names.items()}


def certified(files: dict[str, Path], **other: Path) -> list[Finding]:
    return list(check_certificates("TLS", tuple((files | other).values()), NOW))


def test_a_certificate_and_its_key_are_ok(tmp_path: Path) -> None:
    findings = certified(pki(tmp_path))
    assert [finding.state for finding in findings] == 4 * ["ok"]
    assert any("until 2027" in finding.text for finding in findings)


@pytest.mark.parametrize(
    ("begins", "days", "expected"),
    [
        (NOW - timedelta(days=100), 50, "expired 2026-04-12"),
        (NOW - timedelta(days=100), 105, "expires 2026-06-06"),
        (NOW + timedelta(days=2), 50, "not valid before 2026-06-02"),
    ],
)
def test_a_certificate_out_of_its_time_is_a_problem(
    tmp_path: Path, begins: datetime, days: int, expected: str
) -> None:
    assert expected in the_problem(certified(pki(tmp_path, begins=begins, days=days))).text


def test_files_that_do_not_belong_together_or_are_none_are_a_problem(tmp_path: Path) -> None:
    files, other = pki(tmp_path / "a"), pki(tmp_path / "b")
    assert "not the key of the certificate" in the_problem(certified(files, key=other["key"])).text
    strange = certified(files, authority=other["authority"])
    assert "not signed by this authority" in the_problem(strange).text
    (tmp_path / "junk").write_text("junk")
    (tmp_path / "junk").chmod(0o600)
    for name, text in (("junk", "expected"), ("nosuch", "No such file")):
        for which in files:
            result = [f for f in certified(files, **{which: tmp_path / name}) if f.state == "problem"]
            assert text in result[0].text


def test_a_key_that_others_may_read_is_a_problem(tmp_path: Path) -> None:
    files = pki(tmp_path)
    files["key"].chmod(0o644)
    result = the_problem(certified(files))
    assert "0644" in result.text
    assert result.todo.startswith("chmod 600")


@pytest.mark.parametrize(("days", "expected"), [(-10, "expired"), (7, "expires"), (300, None)])
def test_the_certificate_that_a_router_s_file_names_is_checked(
    tmp_path: Path, days: int, expected: str | None
) -> None:
    begins = datetime.now(UTC) - timedelta(days=20)
    files = pki(tmp_path / "tls", begins=begins, days=days + 20)
    fields = ("root_ca_certificate", "connect_certificate", "connect_private_key")
    tls = dict(zip(fields, map(str, files.values()), strict=True))
    router = {"mode": "client", "connect": {"endpoints": ["tls/127.0.0.1:1"]}}
    router["transport"] = {"link": {"tls": tls}}
    (tmp_path / "vehicle_router.json5").write_text(json.dumps(router))
    result = [each for each in tool.examine(tmp_path, offline=True) if each.what.startswith("router ")]
    wrong = [each.text for each in result if each.state == "problem"]
    assert result
    assert (len(wrong) == 1 and expected in wrong[0]) if expected else not wrong


def map_settings(folder: Path, **more: Any) -> Any:
    return MapServerSettings(**{"release": folder, **more})


def test_a_map_of_another_datum_or_too_old_is_a_problem(tmp_path: Path) -> None:
    write(tmp_path, [surface(5)])
    assert set(states(check_map(map_settings(tmp_path), "WGS84")).values()) == {"ok"}
    assert "days old" in the_problem(check_map(map_settings(tmp_path, max_age_days=0.001), None)).text
    write(tmp_path / "other", [surface(5)], datum="JGD2011")
    of_server = the_problem(check_map(map_settings(tmp_path / "other"), "JGD2011"))
    assert "map JGD2011, map_server.toml WGS84" in of_server.text
    same = map_settings(tmp_path / "other", datum="JGD2011")
    assert "gnss.toml WGS84" in the_problem(check_map(same, "WGS84")).text


def test_a_map_that_is_not_there_or_damaged_is_a_problem(tmp_path: Path) -> None:
    assert the_problem(check_map(map_settings(tmp_path / "no"), None)).what == "map"
    write(tmp_path, [surface(5)])
    for blob in (tmp_path / "blobs").glob("*/*"):
        data = bytearray(blob.read_bytes())
        data[-1] ^= 1
        blob.chmod(0o600)
        blob.write_bytes(bytes(data))
    assert the_problem(check_map(map_settings(tmp_path), None)).what.startswith("map")


def test_a_map_without_the_trusted_signature_or_fetched_without_a_key_is_a_problem(tmp_path: Path) -> None:
    pem = tmp_path / "map.pem"
    pem.write_bytes(KEY.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    write(tmp_path / "map", [surface(5)])
    write(tmp_path / "signed", [surface(5)], signing_key=KEY)
    assert "sign" in the_problem(check_map(map_settings(tmp_path / "map", public_key=pem), None)).text
    fetching = {"store": tmp_path / "map.sqlite"}
    result = the_problem(check_map(map_settings(tmp_path / "map", **fetching), None))
    assert result.what == "map, signature"
    assert "without public_key no newer release is fetched" in result.text
    for name, more in (("signed", {"public_key": pem}), ("map", fetching | {"unsigned": True})):
        assert set(states(check_map(map_settings(tmp_path / name, **more), None)).values()) == {"ok"}


def service(endpoint: str = "tcp/127.0.0.1:1", **more: Any) -> Any:
    return ServiceSettings(vehicle="car", zenoh=ZenohSettings(mode="client", connect=[endpoint]), **more)


def test_a_router_that_lets_us_in_is_ok_and_none_is_a_problem() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_session(ZenohSettings(mode="router", listen=[endpoint], connect=[])):
        assert set(states(check_bus(service(endpoint))).values()) == {"ok"}
    assert set(states(check_bus(service(endpoint))).values()) == {"problem"}


def test_a_port_that_is_taken_or_wanted_twice_is_a_problem() -> None:
    port = free_port()
    both = [("gnss", service(metrics_port=port)), ("integrity", service(metrics_port=port))]
    assert states(check_ports(both[:1])) == {f"port 127.0.0.1:{port} of gnss": "ok"}
    assert "also assigned to gnss" in the_problem(check_ports(both)).text
    with socket.create_server(("127.0.0.1", port)):
        assert "in use" in the_problem(check_ports(both[:1])).text


@pytest.mark.parametrize(
    ("one", "other", "meet"),
    [
        ("0.0.0.0", "127.0.0.1", True),
        ("127.0.0.1", "0.0.0.0", True),
        ("[::]", "127.0.0.1", True),
        ("[::]", "0.0.0.0", True),
        ("127.0.0.1", "127.0.0.2", False),
        ("0.0.0.0", "[::1]", False),
    ],
)
def test_a_port_on_all_addresses_is_one_on_each_of_them(one: str, other: str, meet: bool) -> None:
    port = free_port()
    hosts = {"gnss": one.strip("[]"), "integrity": other.strip("[]")}
    services = [(name, service(metrics_port=port, metrics_host=host)) for name, host in hosts.items()]
    assert ["also assigned to gnss" in each.text for each in check_ports(services)] == [False, meet]


def test_ports_and_hosts_that_there_cannot_be_are_problems() -> None:
    listening = ZenohSettings(mode="peer", connect=[], listen=["tcp/127.0.0.1:99999", "tcp/a..b:7447"])
    settings = service().model_copy(update={"zenoh": listening})
    result = list(check_ports([("gnss", settings)]))
    assert [(finding.what, finding.state) for finding in result] == [
        ("port 127.0.0.1:99999 of gnss", "problem"),
        ("port a..b:7447 of gnss", "problem"),
    ]
    for endpoint in ("tcp/router..example:7447", "tcp/127.0.0.1:99999"):
        tried = next(check_bus(service(endpoint)))
        assert (tried.what, tried.state) == (f"bus {endpoint}", "problem")
        assert tried.text


def test_a_port_that_a_running_service_of_ours_has_is_ok() -> None:
    server = MetricsServer("127.0.0.1", 0, HealthCollector("gnss", "car"))
    try:
        result = list(check_ports([("gnss", service(metrics_port=server.port))]))
    finally:
        server.close()
    assert [(finding.state, "running service" in finding.text) for finding in result] == [("ok", True)]


@contextmanager
def receiver(*, late_s: float = 0.05, bytes_of: Any = None) -> Iterator[str]:
    """A server that sends a position of `late_s` ago, or the bytes given, five times a second."""
    server = socket.create_server(("127.0.0.1", 0))
    ended = threading.Event()

    def say(connection: socket.socket) -> None:
        with connection:
            while not ended.wait(0.2):
                time_ns = SystemClock().now_ns() - round(late_s * 1e9)
                solution = ReceiverSolution(
                    time_ns=time_ns // 10_000_000 * 10_000_000,
                    latitude_rad=0.6,
                    longitude_rad=2.4,
                    height_m=50.0,
                    quality=SolutionQuality.FIX,
                    satellites=14,
                    covariance_enu_m2=None,
                )
                data = format_rmc(solution) + format_gga(solution, geoid_separation_m=37.0)
                try:
                    connection.sendall(data if bytes_of is None else bytes_of)
                except OSError:
                    return

    def serve() -> None:
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            threading.Thread(target=say, args=(connection,), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield f"tcp:127.0.0.1:{server.getsockname()[1]}"
    finally:
        ended.set()
        server.shutdown(socket.SHUT_RDWR)
        server.close()


def gnss_settings(source: str, **more: Any) -> Any:
    fields: dict[str, Any] = {"source": source, "protocol": "nmea"}
    fields |= {"base_protocol": "rtcm", "ntrip_version": 2}
    fields |= dict.fromkeys(("base_source", "ntrip_user", "ntrip_password", "ntrip_ca_file"))
    return SimpleNamespace(**(fields | more))


def received(settings: Any, seconds: float = 2.0) -> dict[str, Finding]:
    return {finding.what: finding for finding in check_receiver(settings, seconds, gnss_runs=False)}


def test_a_receiver_with_the_protocol_of_the_settings_and_current_times_is_ok() -> None:
    with receiver() as url:
        result = received(gnss_settings(url))
    assert result["receiver"].state == result["clock against the receiver"].state == "ok"
    assert "nmea" in result["receiver"].text
    assert result["corrections"].state == "not checked"


def test_a_receiver_of_another_time_or_protocol_silent_or_absent_is_a_problem() -> None:
    with receiver(late_s=18.02) as url:
        result = received(gnss_settings(url))["clock against the receiver"]
    assert (result.state, "leap seconds" in result.todo) == ("problem", True)
    with receiver() as url:
        result = received(gnss_settings(url, protocol="ubx", base_source=url))
    for what, text in (("receiver", "without ubx"), ("corrections", "without rtcm")):
        assert (result[what].state, text in result[what].text) == ("problem", True)
    with receiver(bytes_of=b"\x00\x01garbage" * 20) as url:
        assert "no frame of any protocol" in received(gnss_settings(url, protocol="mixed"))["receiver"].text
    with receiver(bytes_of=b"") as url:
        assert "no data within" in received(gnss_settings(url), 1.0)["receiver"].text
    away = received(gnss_settings(f"tcp:127.0.0.1:{free_port()}"), 1.0)["receiver"]
    assert (away.state, "refused" in away.text.lower()) == ("problem", True)


def test_a_serial_port_that_gnss_has_is_left_to_it() -> None:
    result = list(check_receiver(gnss_settings("serial:/dev/ttyACM0"), 1.0, gnss_runs=True))
    assert {finding.state for finding in result} == {"not checked"}


@pytest.fixture
def deployment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Settings of a vehicle that is well, on a machine that is."""
    monkeypatch.setattr(tool, "kernel_discipline", lambda: SYNCHRONISED)
    write(tmp_path / "map", [surface(5)])
    folder = tmp_path / "config"
    folder.mkdir()
    for name, setting in (
        ("gnss", 'source = "bus"'),
        ("map_server", f'release = "{tmp_path / "map"}"'),
        ("integrity", f'state_dir = "{tmp_path / "state"}"'),
    ):
        (folder / f"{name}.toml").write_text(f'vehicle = "car"\n{setting}\n')
    return folder


def test_a_deployment_that_is_ok_is_code_0(deployment: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tool.main([str(deployment), "--offline"]) == 0
    output = capsys.readouterr().out
    assert output.endswith("no problem\n")
    assert "ok          settings gnss.toml" in output
    assert "ok          disk of integrity" in output
    assert "no settings here of localizer, antenna_height; a vehicle needs them all" in output


@pytest.mark.parametrize(
    ("file", "text", "expected"),
    [
        ("gnss.toml", 'vehicle = "car"\nsorce = "bus"\n', "sorce: unknown setting"),
        ("gnss.toml", 'vehicle = "van"\nsource = "bus"\n', "not the same in all files"),
        ("gnss.toml", 'vehicle = "car"\ndatum = "JGD2011"\n', "gnss.toml JGD2011"),
        ("gnss.toml", "vehicle = ", "not TOML"),
        ("nosuch.toml", "", "no service has this name"),
        ("runtime.toml", "", "settings runtime.toml: no service has this name"),
        ("antenna_height.toml", 'vehicle = "car"\n', "without fixed_height_m"),
        ("map_update.toml", 'state_dir = "/tmp"\nreference = "/nosuch"\n', "reference: /nosuch"),
        (
            "router.json5",
            '{access_control: {rules: [{id: "1", permission: "allow", messages: ["put"], key_exprs: '
            '["camber/v1/van/echo"]}]}}',
            "router.json5 van",
        ),
        ("integrity.toml", 'vehicle = "car"\nstate_dir = "/proc/state"\n', "disk of integrity"),
    ],
)
def test_a_deployment_with_a_fault_is_code_1_and_says_what_to_do(
    deployment: Path, capsys: pytest.CaptureFixture[str], file: str, text: str, expected: str
) -> None:
    (deployment / file).write_text(text)
    assert tool.main([str(deployment), "--offline", "--json"]) == 1
    problems = [result for result in json.loads(capsys.readouterr().out) if result["state"] == "problem"]
    assert any(expected in f"{result['what']}: {result['text']}" for result in problems)
    assert all(result["todo"] for result in problems)


def test_no_folder_is_wrong_usage_and_an_empty_one_a_problem(tmp_path: Path) -> None:
    assert tool.main([str(tmp_path / "nosuch")]) == 2
    assert tool.main([str(tmp_path / ("x" * 300))]) == 2, "as where we may not look: an OSError"
    assert tool.main([str(tmp_path), "--offline"]) == 1
