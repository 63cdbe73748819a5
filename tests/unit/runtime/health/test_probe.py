"""The probe asks the same question as `camber health`, understands the answer, and loads next to nothing for it."""

import subprocess
import sys

import pytest

from camber.runtime.health import probe
from camber.runtime.settings import ServiceSettings, load
from camber.schemas.base import EARLIEST_NS
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import decode, encode, encoding_of
from camber.schemas.health import Health, HealthRequest

NOW_NS = 1_400_000_000_000_000_000


def health(status):
    return Health(
        time_ns=NOW_NS, service="integrity", version="0.1.0", status=status, uptime_s=1.0, loop_age_s=0.0
    )


def test_the_question_is_a_health_request():
    received = decode(HealthRequest, probe.question(NOW_NS), probe._ENCODING)
    assert received.message == HealthRequest(time_ns=NOW_NS)
    assert encoding_of(HealthRequest) == probe._ENCODING


def test_it_is_asked_where_the_table_of_channels_says():
    key = BY_NAME["health"].key_for("car").replace("{service}", "integrity")
    assert probe.key_of("car", "integrity") == key


@pytest.mark.parametrize("status", ["starting", "ok", "degraded", "failing"])
def test_the_answer_is_understood(status):
    assert probe.status_in(encode(health(status), source="integrity", sequence=7)) == status


@pytest.mark.parametrize("answer", [b"", b"\x01", b"\xff" * 40, encode(HealthRequest(time_ns=NOW_NS))])
def test_what_is_no_answer_is_refused(answer):
    with pytest.raises(ValueError):  # noqa: PT011 (any of them ends the probe alike)
        probe.status_in(answer)


@pytest.mark.parametrize(
    "environ",
    [
        {},
        {"CAMBER_INTEGRITY_VEHICLE": "van"},
        {"CAMBER_INTEGRITY_ZENOH__CONNECT": '["tcp/127.0.0.1:9"]'},
        {"CAMBER_INTEGRITY_ZENOH": '{"connect": ["tcp/127.0.0.1:9"]}'},
        {"VEHICLE": "another", "ZENOH__CONNECT": '["tcp/127.0.0.1:9"]'},
    ],
)
def test_it_reads_settings_as_the_service_does(tmp_path, monkeypatch, environ):
    class Settings(ServiceSettings):
        """Those of all."""

        SERVICE = "integrity"

    path = tmp_path / "integrity.toml"
    path.write_text('vehicle = "car"\n[zenoh]\nconnect = ["tcp/router:7447"]\n')
    for name, text in environ.items():
        monkeypatch.setenv(name, text)
    settings, _ = load(Settings, ["--config", str(path)], prog="test")
    bus = probe.bus_of("integrity", path, environ)
    assert (bus.vehicle, bus.connect) == (settings.vehicle, settings.zenoh.connect)


def test_without_a_file_it_asks_where_a_service_without_settings_is(tmp_path):
    bus = probe.bus_of("integrity", tmp_path / "none.toml", {})
    assert (bus.vehicle, bus.connect) == (ServiceSettings().vehicle, ServiceSettings().zenoh.connect)


@pytest.mark.parametrize(
    ("command", "service", "settings"),
    [
        ("/opt/bin/python /opt/bin/camber gnss --config /etc/gnss.toml", "gnss", "/etc/gnss.toml"),
        ("/sbin/docker-init -- camber map_server --config=/etc/m.toml", "map_server", "/etc/m.toml"),
        ("/opt/bin/python -m camber.cli router --connect tls/a:1", "router", None),
        ("camber map-server --set period_s=1", "map_server", None),
        ("/sbin/docker-init -- camber router --config-file /etc/r.json5", "router", None),
    ],
)
def test_it_asks_what_runs_as_the_first_process(command, service, settings):
    result, file = probe.runs_here(command.split())
    assert (result, file and str(file)) == (service, settings)


@pytest.mark.parametrize("command", ["", "sh -c true", "camber", "camber --help"])
def test_where_no_service_runs_it_says_so(tmp_path, monkeypatch, capsys, command):
    first = tmp_path / "cmdline"
    first.write_text(command.replace(" ", "\0") + "\0")
    monkeypatch.setattr(probe, "FIRST_PROCESS", first)
    assert probe.main([]) == 2
    assert f"expected the name of a service; {command} runs here" in capsys.readouterr().err


def test_it_loads_no_numbers_and_no_models():
    heavy = "{'numpy', 'pydantic', 'camber.schemas.base'}"
    code = f"import sys, camber.runtime.health.probe; print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_nobody_there_is_one_line_and_exit_code_1(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(probe, "WITHIN_S", 0.3)
    path = tmp_path / "gnss.toml"
    path.write_text('[zenoh]\nconnect = ["tcp/127.0.0.1:9"]\n')
    assert probe.main(["gnss", str(path)]) == 1
    assert capsys.readouterr().out.startswith("gnss: no answer: cannot join the bus")
    path.write_text("zenoh = {")
    assert probe.main(["gnss", str(path)]) == 1
    assert capsys.readouterr().out.count("\n") == 1


def test_a_clock_that_lags_far_probes_all_the_same():
    assert decode(HealthRequest, probe.question(-1), probe._ENCODING).message.time_ns == EARLIEST_NS
