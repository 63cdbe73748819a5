"""What images hold: no more than their role needs, nothing heavy, nobody's rights; and the same when built again."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from camber.schemas.channels import VEHICLE_SERVICES
from support.containers import BUILD_LIMIT_S, Stack, docker, skip_without_engine
from support.containers import stack as started_stack

pytestmark = [pytest.mark.container, pytest.mark.slow]

MB = 10**6
VEHICLE_LIMIT_BYTES = 600 * MB
JUDGE_LIMIT_BYTES = 250 * MB
VEHICLE = (*VEHICLE_SERVICES, "vehicle_router")
NEVER = ("open3d", "scipy", "matplotlib", "pytest", "pip", "rasterio")


@pytest.fixture(scope="module")
def images() -> Iterator[Stack]:
    skip_without_engine()
    with started_stack("images", "vehicle") as stack:
        yield stack


def facts(images: Stack, service: str) -> dict[str, Any]:
    inspected: dict[str, Any] = json.loads(docker("image", "inspect", images.image(service)))[0]
    return inspected


def in_image(images: Stack, service: str, code: str) -> str:
    """What a line of Python prints in a container of an image, without network."""
    command = ("run", "--rm", "--network", "none", "--read-only", "--entrypoint", "python")
    return docker(*command, images.image(service), "-c", code).strip()


@pytest.mark.parametrize("service", VEHICLE)
def test_images_of_a_vehicle_are_small(images: Stack, service: str) -> None:
    size = facts(images, service)["Size"]
    print(f"{service}: {size / MB:.0f} MB")
    assert size <= (JUDGE_LIMIT_BYTES if service == "integrity" else VEHICLE_LIMIT_BYTES)


def test_images_share_what_they_have_in_common(images: Stack) -> None:
    """So that a vehicle keeps little more than its largest image."""
    layers = {service: facts(images, service)["RootFS"]["Layers"] for service in VEHICLE}
    together = len({layer for of_service in layers.values() for layer in of_service})
    assert together < sum(len(of_service) for of_service in layers.values()) / 2
    assert layers["gnss"][:-2] == layers["localizer"][:-2] or layers["gnss"][:-4] == layers["localizer"][:-4]


@pytest.mark.parametrize("service", VEHICLE)
def test_there_is_nothing_heavy_in_them(images: Stack, service: str) -> None:
    code = (
        "from importlib.util import find_spec\n"
        f"found = {{name: find_spec(name) for name in {NEVER!r}}}\n"
        "print([name for name, spec in found.items() if spec and '/opt/' in str(spec.origin)])"
    )
    assert in_image(images, service, code) == "[]"


@pytest.mark.parametrize("service", VEHICLE)
def test_they_run_as_nobody(images: Stack, service: str) -> None:
    assert facts(images, service)["Config"]["User"] == "10001:10001"
    assert in_image(images, service, "import os; print([n for n in os.environ if 'PIP' in n])") == "[]"


@pytest.mark.parametrize("service", VEHICLE)
def test_their_code_is_roots_and_nobody_else_may_change_it(images: Stack, service: str) -> None:
    """By its owner and its modes: a container whose file system is read-only would refuse root, too."""
    code = (
        "import os, stat\n"
        "paths = [f'{folder}/{name}' for folder, *names in os.walk('/opt') for name in sum(names, ['.'])]\n"
        "facts = {path: os.lstat(path) for path in paths}\n"
        "loose = [path for path, fact in facts.items()\n"
        "         if fact.st_uid or fact.st_mode & 0o022 and not stat.S_ISLNK(fact.st_mode)]\n"
        "print(len(paths) > 1000, loose[:10])"
    )
    assert in_image(images, service, code) == "True []"


@pytest.mark.parametrize("service", ["gnss", "map_server", "localizer"])
def test_machine_code_is_in_them_and_is_used(images: Stack, service: str) -> None:
    """A read-only container cannot keep what it would compile: nothing is compiled."""
    code = (
        "import numba.core.event as e, runpy\n"
        "with e.install_recorder('numba:compile') as seen:\n"
        f"    runpy.run_module('camber.{service}.warm_up', run_name='__main__')\n"
        "print(len([1 for _, x in seen.buffer if x.is_end]))"
    )
    assert in_image(images, service, code).splitlines()[-1] == "0"


def test_built_again_the_judge_is_the_same_to_the_last_bit(images: Stack) -> None:
    """From nothing, packages and all: a vehicle's operator can see that an image is what its commit says."""
    again = f"{images.project}-again"
    build = ("build", "--quiet", "--no-cache", "--file", "deploy/Dockerfile")
    passed_on = ("PIP_INDEX_URL", "PYTHON_IMAGE")  # by the environment, where they are set there
    arguments = [part for each in ("KIND=least", *passed_on) for part in ("--build-arg", each)]
    docker(*build, *arguments, "--tag", again, ".", timeout_s=BUILD_LIMIT_S)
    try:
        twice = json.loads(docker("image", "inspect", again))[0]
        assert twice["RootFS"]["Layers"] == facts(images, "integrity")["RootFS"]["Layers"]
    finally:
        docker("image", "rm", again)
