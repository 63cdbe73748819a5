"""The settings that are deployed: whole, right, and safe where something has not been measured. Needs no engine."""

from __future__ import annotations

import atexit
import functools
import importlib
import os
import re
import shutil
import subprocess
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import pytest

from camber.replay.drive_inputs import prepare_drive
from camber.replay.service_settings import service_settings
from camber.runtime.session import router_endpoints
from camber.runtime.settings import load
from camber.schemas.channels import SENSORS, SERVICES, VEHICLE_SERVICES
from camber.schemas.drive import load_manifest
from support.release_world import write_signing_keys
from support.running import camber, python
from support.tree import ROOT

CONFIG = ROOT / "deploy" / "config"
SETS = {"demo": SERVICES, "vehicle": (*VEHICLE_SERVICES, SENSORS), "cloud": ("map_update",)}
EACH = [(folder, service) for folder, services in SETS.items() for service in services]
VEHICLES = ("demo", "vehicle")
of_each_file = pytest.mark.parametrize(
    "path", sorted(CONFIG.glob("*/*.toml")), ids=lambda path: f"{path.parent.name}/{path.stem}"
)


@functools.cache
def public_key() -> Path:
    """A key of map releases, as an operator installs it."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder)
    return write_signing_keys(folder, folder)[1]


def key_options(path: Path) -> list[str]:
    """The key that a vehicle's map server does not start without."""
    return ["--public-key", str(public_key())] if path.match("vehicle/map_server.toml") else []


def settings_of(folder: str, service: str) -> Any:
    cls = importlib.import_module(f"camber.{service}.service").SERVICE.SETTINGS
    path = CONFIG / folder / f"{service}.toml"
    return load(cls, ["--config", str(path), *key_options(path)], prog="test")[0]


@pytest.mark.parametrize(("folder", "service"), EACH)
def test_each_service_takes_its_settings_and_joins_the_router(folder: str, service: str) -> None:
    settings = settings_of(folder, service)
    endpoint = "tls/router:7448" if folder == "cloud" else "tcp/router:7447"
    assert (settings.zenoh.mode, settings.zenoh.connect) == ("client", [endpoint])
    assert settings.clock == "system"


@of_each_file
def test_the_commands_find_every_file_right(path: Path) -> None:
    done = camber(path.stem, "--config", path, "--check", *key_options(path))
    assert (done.returncode, done.stderr) == (0, f"camber {path.stem}: settings are right\n")


@of_each_file
def test_what_stands_there_as_a_comment_is_right_too(path: Path) -> None:
    """Each setting that is commented out, by itself, is one that there is."""
    cls = importlib.import_module(f"camber.{path.stem}.service").SERVICE.SETTINGS
    table = ""
    for line in path.read_text().splitlines():
        table = line.strip("[]") if line.startswith("[") else table
        if match := re.match(r"# (\w+) = ", line):
            owner = cls if not table else cls.model_fields[table].annotation
            assert match[1] in owner.model_fields, f"{path.name}: {match[1]}"


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


def test_a_vehicle_takes_only_signed_releases_that_are_not_too_old() -> None:
    path = CONFIG / "vehicle" / "map_server.toml"
    done = camber("map_server", "--config", path, "--check")
    assert done.returncode == 2
    assert "public_key: /etc/camber/release.pub: public key, expected an Ed25519 key" in done.stderr
    assert settings_of("vehicle", "map_server").max_age_days == 400.0


def test_a_vehicle_that_was_not_measured_confirms_nothing() -> None:
    assert settings_of("vehicle", "antenna_height").fixed_height_m is None


def test_the_demo_knows_the_vehicle_that_it_drives(tmp_path: Path) -> None:
    """The car of the simulated city, by what a replay of its drive would set."""
    begin = ("--set", "duration_s=0.5", "--out", tmp_path, "--quiet")
    assert camber("simulate", "city", *begin, timeout_s=120.0).returncode == 0
    inputs = prepare_drive(load_manifest(tmp_path / "drive.toml"), tmp_path / "work")
    of_a_replay = service_settings(inputs, tmp_path)
    for service in ("gnss", "map_server", "localizer", "antenna_height"):
        deployed = settings_of("demo", service).model_dump(exclude_none=True)
        for name, value in of_a_replay[service].items():
            if name not in ("vehicle", "clock", "state_dir", "release", "engine"):
                assert plain(deployed[name]) == plain(value), f"{service}: {name}"


def plain(value: Any) -> Any:
    return (
        {name: item for name, item in value.items() if item is not None} if isinstance(value, dict) else value
    )


def requirements(*arguments: str) -> subprocess.CompletedProcess[str]:
    return python(ROOT / "deploy" / "requirements.py", ROOT / "pyproject.toml", *arguments)


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
    assert requirements("map,engine", "compiled").stdout.split("\n")[:-1] == wanted
    assert requirements("", "least").stdout == "\n"
    assert requirements("nosuch", "compiled").returncode == 1


@pytest.mark.parametrize("kind", [["least"], ["whole"], []])
def test_an_image_without_the_compiler_refuses_extras_that_need_it(kind: list[str]) -> None:
    done = requirements("map,simulator", *kind)
    assert (done.returncode, done.stdout) == (1, "")
    assert "extra simulator needs numba: expected KIND compiled" in done.stderr
    assert requirements("map", *kind).returncode == 0


DOCKERFILE = (ROOT / "deploy" / "Dockerfile").read_text()


def test_the_base_of_the_images_is_named_once_and_may_be_another() -> None:
    bases = re.findall(r"^FROM (\S+)", DOCKERFILE, re.M)
    stages = re.findall(r"^FROM \S+ AS (\S+)", DOCKERFILE, re.M)
    others = {base for base in bases if base not in stages and "${KIND}" not in base}
    assert others == {"${PYTHON_IMAGE}"}
    assert re.search(r"^ARG PYTHON_IMAGE=python:3\.\d+-slim$", DOCKERFILE.partition("FROM")[0], re.M)


def test_pip_takes_the_settings_of_the_images_as_they_are_meant() -> None:
    """By pip's own parser: of options that begin with `no` some take their variable for the opposite."""
    settings = re.findall(r"\b(PIP_\w+)=(\S+)", re.sub(r"#.*", "", DOCKERFILE))
    ask = (
        "from pip._internal.commands import create_command\n"
        "options, _ = create_command('install').parser.parse_args([])\n"
        "print(bool(options.compile), options.cache_dir, options.constraints)"
    )
    environ = {name: text for name, text in os.environ.items() if not name.startswith("PIP_")}
    environ |= {**dict(settings), "PIP_CONFIG_FILE": os.devnull}
    done = python("-c", ask, env=environ)
    assert done.stdout.strip() == "False False ['/src/constraints.txt']"
    assert dict(settings)["PIP_BUILD_CONSTRAINT"] == "/src/constraints.txt"


def test_a_machine_with_one_processor_can_start_them_all() -> None:
    """The engine refuses a container that may use more than there are."""
    compose = (ROOT / "docker-compose.yml").read_text()
    assert set(re.findall(r"^ +cpus: (.+)$", compose, re.M)) == {"1", "${CAMBER_CPUS:-2}"}
