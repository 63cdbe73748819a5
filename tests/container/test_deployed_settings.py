"""The settings that are deployed: whole, right, and safe where something has not been measured. Needs no engine."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from camber.runtime.session import router_endpoints
from camber.runtime.settings import load
from camber.schemas.channels import SENSORS, SERVICES, VEHICLE_SERVICES
from camber.simulator.short_drive import ANTENNA_HEIGHT_M, write_short_drive
from support.running import camber
from support.tree import ROOT

CONFIG = ROOT / "deploy" / "config"
SETS = {"demo": SERVICES, "vehicle": (*VEHICLE_SERVICES, SENSORS), "cloud": ("map_update",)}
EACH = [(folder, service) for folder, services in SETS.items() for service in services]
VEHICLES = ("demo", "vehicle")


def settings_of(folder: str, service: str) -> Any:
    cls = importlib.import_module(f"camber.{service}.service").SERVICE.SETTINGS
    return load(cls, ["--config", str(CONFIG / folder / f"{service}.toml")], prog="test")[0]


@pytest.mark.parametrize(("folder", "service"), EACH)
def test_each_service_takes_its_settings_and_joins_the_router(folder: str, service: str) -> None:
    settings = settings_of(folder, service)
    endpoint = "tls/router:7448" if folder == "cloud" else "tcp/router:7447"
    assert (settings.zenoh.mode, settings.zenoh.connect) == ("client", [endpoint])
    assert settings.clock == "system"


@pytest.mark.parametrize(
    "path", sorted(CONFIG.glob("*/*.toml")), ids=lambda path: f"{path.parent.name}/{path.stem}"
)
def test_the_commands_find_every_file_right(path: Path) -> None:
    done = camber(path.stem, "--config", path, "--check")
    assert (done.returncode, done.stderr) == (0, f"camber {path.stem}: settings are right\n")


@pytest.mark.parametrize(
    "path", sorted(CONFIG.glob("*/*.toml")), ids=lambda path: f"{path.parent.name}/{path.stem}"
)
def test_what_stands_there_as_a_comment_is_right_too(path: Path, tmp_path: Path) -> None:
    """Each setting that is commented out, by itself, is one that there is."""
    cls = importlib.import_module(f"camber.{path.stem}.service").SERVICE.SETTINGS
    table = ""
    for line in path.read_text().splitlines():
        table = line.strip("[]") if line.startswith("[") else table
        if found := re.match(r"# (\w+) = ", line):
            owner = cls if not table else cls.model_fields[table].annotation
            assert found[1] in owner.model_fields, f"{path.name}: {found[1]}"


@pytest.mark.parametrize("name", ["demo/vehicle_router", "demo/cloud_router", "vehicle/vehicle_router"])
def test_routers_take_their_files(name: str) -> None:
    listen, _, tls = router_endpoints(CONFIG / f"{name}.json5")
    assert "tcp/0.0.0.0:7447" in listen
    assert not any(tls.values())


@pytest.mark.parametrize("folder", VEHICLES)
def test_the_services_of_a_vehicle_bear_its_name(folder: str) -> None:
    services = [service for of, service in EACH if of == folder and service != "map_update"]
    assert len({settings_of(folder, service).vehicle for service in services}) == 1


def test_the_services_of_a_vehicle_agree_on_the_datum() -> None:
    assert settings_of("vehicle", "gnss").datum == settings_of("vehicle", "map_server").datum


@pytest.mark.parametrize(
    ("folder", "service"),
    [
        ("demo", "integrity"),
        ("cloud", "map_update"),
        *(("vehicle", service) for service in ("localizer", "antenna_height", "integrity")),
    ],
)
def test_what_must_survive_is_on_a_volume(folder: str, service: str) -> None:
    assert settings_of(folder, service).state_dir == Path("/var/lib/camber/state")
    assert re.search(rf"\b{service}:/var/lib/camber/state\b", (ROOT / "docker-compose.yml").read_text())


def test_the_map_of_a_vehicle_survives_too() -> None:
    assert settings_of("vehicle", "map_server").store.parent == Path("/var/lib/camber/state")


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


def test_an_image_gets_the_requirements_of_its_kind_and_extras() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    least, whole, compiled = (
        requirements(kind).stdout.split("\n")[:-1] for kind in ("least", "whole", "compiled")
    )
    assert sorted(least + whole) == sorted(project["dependencies"])
    assert not set(least) & set(whole)
    assert [line.split(">")[0] for line in compiled] == ["numba"]
    extras = project["optional-dependencies"]
    wanted = [line for name in ("map", "engine") for line in extras[name] if line not in compiled]
    assert requirements("map,engine").stdout.split("\n")[:-1] == wanted
    assert requirements("nosuch").returncode == 1
