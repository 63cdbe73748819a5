"""An upgrade and a roll-back: services of two releases on one bus, whose messages differ in version.

The other release is this one with a patched copy of its schemas, run as real processes beside the present ones.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from camber.schemas.channels import SERVICES
from camber.schemas.integrity import Verdict
from support.live_drive import TRUSTED
from support.live_vehicle import LiveVehicle, Witness, driving
from support.running import free_endpoint, wait_until
from support.tree import ROOT

pytestmark = pytest.mark.slow

BUMP = "    SCHEMA_VERSION: ClassVar[int] = 2\n"
MIXED_S = 6.0


def other_release(folder: Path, module: str, message: str) -> list[str]:
    """Python that runs `camber` with another version of one message: with a field more, and another number."""
    schemas = folder / "camber" / "schemas"
    shutil.copytree(ROOT / "schemas/camber/schemas", schemas, ignore=shutil.ignore_patterns("__pycache__"))
    path = schemas / f"{module}.py"
    head, body = path.read_text().split(f"class {message}(Message):\n")
    docstring, rest = body.split('"""\n', 1) if body.lstrip().startswith('"""') else ("", body)
    future = "from __future__ import annotations\n"
    head = head.replace(future, f"{future}from typing import ClassVar\n", 1)
    more = f"{BUMP}    of_the_other_release: int = 7\n"
    path.write_text(f'{head}class {message}(Message):\n{docstring}"""\n{more}{rest}')
    code = (
        f"import sys; sys.path.insert(0, {str(folder)!r}); from camber.cli import main; "
        f"import camber.schemas.{module} as m; assert m.{message}.SCHEMA_VERSION == 2; raise SystemExit(main())"
    )
    return ["-c", code]


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[tuple[LiveVehicle, Witness]]:
    vehicle = LiveVehicle(tmp_path, free_endpoint(), services=SERVICES)
    with driving(vehicle) as witness:
        yield vehicle, witness


def counter(vehicle: LiveVehicle, service: str, name: str) -> int:
    health = vehicle.health(service)
    return 0 if health is None else health.counters.get(name, 0)


def replaced(vehicle: LiveVehicle, service: str, launcher: list[str]) -> None:
    vehicle.kill(service)
    vehicle.start(service, *launcher, service, "--config", vehicle.config(service))
    wait_until(lambda: vehicle.health(service), timeout_s=60.0, why=f"{service} does not answer")


def test_fixes_of_another_version_are_refused_until_it_is_rolled_back(
    tmp_path: Path, vehicle: tuple[LiveVehicle, Witness]
) -> None:
    car, witness = vehicle
    replaced(car, "gnss", other_release(tmp_path / "other", "gnss", "Fix"))
    refused = wait_until(
        lambda: counter(car, "integrity", "fix.undecodable"), timeout_s=30.0, why="nothing was refused"
    )
    begin_s = time.monotonic()
    time.sleep(MIXED_S)
    assert counter(car, "integrity", "fix.undecodable") > refused + 10, "it goes on coming, and is counted"
    assert [verdict for verdict in witness.messages(Verdict, begin_s) if verdict.verdict in TRUSTED] == []
    health = car.health("integrity")
    assert health is not None
    assert any("expected encoding" in issue.text and ".Fix.v1" in issue.text for issue in health.issues)
    # Health is of one version in both, and the others go on.
    for service in SERVICES:
        health = car.health(service)
        assert health is not None, service
        assert health.status in ("ok", "degraded"), service
    assert car.ended() == {}

    rolled_back_s = time.monotonic()
    replaced(car, "gnss", ["-m", "camber.cli"])
    witness.wait_for_trust(rolled_back_s, timeout_s=60.0)
    assert not witness.wrong_but_trusted(), witness.verdict_counts()


def test_uploads_wait_for_a_cloud_that_understands_them(
    tmp_path: Path, vehicle: tuple[LiveVehicle, Witness]
) -> None:
    car, witness = vehicle
    replaced(car, "map_update", other_release(tmp_path / "other", "fleet", "UploadBatch"))
    began_s = time.monotonic()
    wait_until(
        lambda: (
            (health := car.health("integrity")) is not None
            and any(issue.code == "upload_unanswered" for issue in health.issues)
        ),
        timeout_s=60.0,
        why="integrity does not say that its uploads are not taken",
    )
    witness.wait_for_trust(began_s)
    verdict = witness.messages(Verdict, began_s)
    waiting = {verdict.time_ns for verdict in verdict if verdict.verdict == "confirmed"}
    assert waiting
    assert not waiting & set(car.stored_ns()), "the other release has taken some"
    replaced(car, "map_update", ["-m", "camber.cli"])
    wait_until(lambda: waiting <= set(car.stored_ns()), timeout_s=60.0, why="what waited has not arrived")
    stored_ns = car.stored_ns()
    assert len(stored_ns) == len(set(stored_ns))
    assert counter(car, "map_update", "refused") == 0
    assert car.ended() == {}
