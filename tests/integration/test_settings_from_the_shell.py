"""Each service's settings as an operator meets them: checked, printed, read again, and a typing error named."""

import tomllib
from pathlib import Path

import pytest

from camber.schemas.channels import SERVICES
from support.running import camber

VALUES = {
    "gnss": 'source = "tcp:127.0.0.1:2101"\nprotocol = "nmea"\n',
    "map_server": 'release = "{folder}/map"\n',
    "localizer": "[initial_pose]\nlatitude_deg = 35.1\nlongitude_deg = 136.9\nyaw_deg = 10.0\n"
    "horizontal_sigma_m = 1.0\nyaw_sigma_deg = 2.0\n",
    "antenna_height": "fixed_height_m = 1.6\nfixed_sigma_m = 0.02\n",
}


@pytest.fixture(params=SERVICES)
def service(request) -> str:
    return request.param


@pytest.fixture
def config(service, tmp_path) -> Path:
    path = tmp_path / f"{service}.toml"
    common = f'vehicle = "car"\nstate_dir = "{tmp_path / "state"}"\n'
    bus = '[zenoh]\nmode = "client"\nconnect = ["tcp/127.0.0.1:7447"]\n'
    path.write_text(common + VALUES.get(service, "").format(folder=tmp_path) + bus)
    return path


def test_settings_are_checked_and_what_is_printed_can_be_read_again(service, config, tmp_path):
    first = camber(service, "--config", config, "--check", "--print-config")
    assert first.returncode == 0, first.stderr
    assert first.stderr.strip() == f"camber {service}: settings are right"
    printed = tmp_path / "printed.toml"
    printed.write_text(first.stdout)
    assert tomllib.loads(first.stdout)["vehicle"] == "car"
    second = camber(service, "--config", printed, "--print-config")
    assert second.stdout == first.stdout


def test_an_unknown_setting_is_one_line_and_exit_code_2(service, config):
    config.write_text('vehicel = "car"\n' + config.read_text())
    done = camber(service, "--config", config)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line == f"camber {service}: {config}: vehicel: unknown setting"
