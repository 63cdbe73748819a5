"""Units for vehicles without containers: whole, confined, never given up. Needs no engine."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from camber.cli import SERVICES, TOOLS
from support.tree import ROOT

UNITS = ROOT / "deploy" / "systemd"
SERVICE_UNITS = ("camber@.service", "camber-router.service")
WITH_MORE = sorted(path.name.removesuffix(".d") for path in UNITS.glob("camber@*.service.d"))
"""Services that have a drop-in."""
NEWER_THAN_SOME = ("RestartSteps", "RestartMaxDelaySec")  # systemd 254; those before pass over them


class _All(dict[str, str]):
    """Keeps what stands there several times."""

    def __setitem__(self, name: str, value: str) -> None:
        super().__setitem__(name, f"{self[name]}\n{value}" if name in self else value)


def unit(name: str) -> dict[str, dict[str, str]]:
    """Sections of a unit; settings that stand there several times, one on each line."""
    sections: dict[str, dict[str, str]] = {}
    for line in (UNITS / name).read_text().splitlines():
        if line.startswith("["):
            sections[line.strip("[]")] = _All()
        elif line and not line.startswith("#"):
            key, _, value = line.partition("=")
            list(sections.values())[-1][key] = value
    return sections


@pytest.mark.parametrize("name", SERVICE_UNITS)
def test_they_start_what_there_is(name: str) -> None:
    command = unit(name)["Service"]["ExecStart"].split()
    assert command[0] == "/opt/camber/bin/camber"
    assert command[1] == "%i" or command[1] in TOOLS
    assert {each.removeprefix("camber@").removesuffix(".service") for each in WITH_MORE} <= set(SERVICES)


@pytest.mark.parametrize("name", SERVICE_UNITS)
def test_they_are_never_given_up(name: str) -> None:
    sections = unit(name)
    assert sections["Unit"]["StartLimitIntervalSec"] == "0"
    assert sections["Service"]["Restart"] == "always"
    assert "RestartPreventExitStatus" not in sections["Service"]
    assert not {"Requires", "BindsTo", "Before"} & set(sections["Unit"]), "no order among services"


@pytest.mark.parametrize("name", SERVICE_UNITS)
def test_they_have_no_rights(name: str) -> None:
    service = unit(name)["Service"]
    assert service["User"] == "camber"
    assert (service["CapabilityBoundingSet"], service["NoNewPrivileges"]) == ("", "yes")
    assert (service["ProtectSystem"], service["ProtectHome"]) == ("strict", "yes")
    assert service["RestrictAddressFamilies"].split() == ["AF_INET", "AF_INET6", "AF_UNIX", "AF_NETLINK"]
    assert {"MemoryMax", "TasksMax"} <= set(service)


@pytest.fixture
def runnable(tmp_path: Path) -> Path:
    """The units with a command that this machine has: whether it is there is looked at, too."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("there is no systemd-analyze")
    folder = tmp_path / "units"
    shutil.copytree(UNITS, folder)
    template = folder / "camber@.service"
    for name in ("camber@integrity.service", *WITH_MORE):
        shutil.copy(template, folder / name)
    template.unlink()
    for path in sorted(folder.glob("*.service")):
        path.write_text(path.read_text().replace("/opt/camber/bin/camber", "/bin/true"))
    return folder


def analyzed(*arguments: object) -> tuple[int, list[str]]:
    done = subprocess.run(
        ["systemd-analyze", *map(str, arguments)], capture_output=True, text=True, timeout=60.0, check=False
    )
    return done.returncode, (done.stdout + done.stderr).splitlines()


def complaints(runnable: Path) -> list[str]:
    units = [path for path in sorted(runnable.iterdir()) if path.suffix in (".service", ".target")]
    _, output = analyzed("verify", *units)
    about_them = [line for line in output if str(runnable) in line]
    return [line for line in about_them if not any(name in line for name in NEWER_THAN_SOME)]


def test_systemd_finds_nothing_wrong_with_them(runnable: Path) -> None:
    assert complaints(runnable) == []


@pytest.mark.parametrize("name", WITH_MORE)
def test_it_would_find_what_is_wrong_with_a_drop_in(runnable: Path, name: str) -> None:
    (drop_in,) = (runnable / f"{name}.d").iterdir()
    drop_in.write_text(drop_in.read_text() + "NoSuchSetting=yes\n")
    assert any(drop_in.name in line and "NoSuchSetting" in line for line in complaints(runnable))


def test_a_receiver_may_be_plugged_in_after_gnss_has_started() -> None:
    """Drivers are there before: systemd allows no group of devices that the kernel does not know at the start."""
    sections = unit("camber@gnss.service.d/receiver.conf")
    drivers = {f"modprobe@{driver}.service" for driver in ("cdc_acm", "usbserial")}
    assert drivers <= set(sections["Unit"]["Wants"].split()) & set(sections["Unit"]["After"].split())
    allowed = sections["Service"]["DeviceAllow"].splitlines()
    assert {f"char-tty{kind} rw" for kind in ("ACM", "USB", "S", "AMA", "THS")} == set(allowed)


@pytest.mark.parametrize("name", ["camber@integrity.service", *WITH_MORE, "camber-router.service"])
def test_systemd_calls_them_well_confined(runnable: Path, name: str) -> None:
    code, output = analyzed("security", "--offline=true", "--threshold=20", runnable / name)
    if any("offline" in line and "unrecognized" in line for line in output):
        pytest.skip("this systemd-analyze looks at no files")
    assert code == 0, output[-1]
