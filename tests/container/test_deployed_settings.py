"""The settings that are deployed: whole, right, and safe where something has not been measured. Needs no engine."""

from __future__ import annotations

import importlib
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from camber.runtime.settings import load
from camber.schemas.channels import SERVICES, VEHICLE_SERVICES
from camber.simulator.short_drive import ANTENNA_HEIGHT_M, write_short_drive
from support.tree import ROOT

CONFIG = ROOT / "deploy" / "config"
SETS = ("demo", "vehicle")


def settings_of(folder: str, service: str) -> Any:
    cls = importlib.import_module(f"camber.{service}.service").SERVICE.SETTINGS
    return load(cls, ["--config", str(CONFIG / folder / f"{service}.toml")], prog="test")[0]


@pytest.mark.parametrize("folder", SETS)
@pytest.mark.parametrize("service", SERVICES)
def test_each_service_takes_its_settings_and_joins_the_router(folder: str, service: str) -> None:
    settings = settings_of(folder, service)
    assert (settings.zenoh.mode, settings.zenoh.connect) == ("client", ["tcp/router:7447"])
    assert settings.clock == "system"


@pytest.mark.parametrize("folder", SETS)
def test_the_services_of_a_vehicle_bear_its_name(folder: str) -> None:
    assert len({settings_of(folder, service).vehicle for service in VEHICLE_SERVICES}) == 1


@pytest.mark.parametrize("folder", SETS)
def test_what_must_survive_is_on_a_volume(folder: str) -> None:
    for service in ("integrity", "map_update"):
        assert settings_of(folder, service).state_dir == Path("/var/lib/camber/state")


def test_a_vehicle_that_was_not_measured_confirms_nothing() -> None:
    assert settings_of("vehicle", "antenna_height").fixed_height_m is None


def test_the_demo_knows_the_vehicle_that_it_drives(tmp_path: Path) -> None:
    drive = tomllib.loads(write_short_drive(tmp_path).read_text())
    assert settings_of("demo", "gnss").vehicle == drive["vehicle"]
    assert settings_of("demo", "gnss").datum == drive["datum"] == settings_of("demo", "map_server").datum
    assert settings_of("demo", "antenna_height").fixed_height_m == ANTENNA_HEIGHT_M


def requirements(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable,
        str(ROOT / "deploy" / "requirements.py"),
        str(ROOT / "pyproject.toml"),
        *arguments,
    ]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_an_image_gets_the_requirements_of_its_extras() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert requirements().stdout.split("\n")[:-1] == project["dependencies"]
    extras = project["optional-dependencies"]
    wanted = [line for name in ("map", "dev") for line in extras[name]]
    assert requirements("map,dev").stdout.split("\n")[:-1] == wanted
    assert requirements("nosuch").returncode == 1
