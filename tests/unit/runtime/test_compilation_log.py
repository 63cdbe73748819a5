"""A service says once that it compiles, and how much; with all machine code on disk it says nothing."""

from __future__ import annotations

import pytest

from camber.compiled.compilation_progress import watchers
from camber.runtime.run import _compilation_logged
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings


class ServiceOfThree(Service[ServiceSettings]):
    NAME = "three"
    SETTINGS = ServiceSettings

    @classmethod
    def compiled_functions(cls, settings: ServiceSettings) -> int:
        return 3


def _log(capfd: pytest.CaptureFixture[str], *, on_disk: int) -> list[str]:
    with _compilation_logged(ServiceSettings(), ServiceOfThree):
        (progress,) = watchers()
        for number in range(3):
            if number < on_disk:
                progress.on_read()
            else:
                progress.on_missing()
                progress.on_compiled()
    assert not watchers()
    return capfd.readouterr().err.splitlines()


@pytest.mark.parametrize(("on_disk", "compiled"), [(0, 3), (1, 2), (2, 1)])
def test_the_number_that_remains_is_logged_in_one_line(
    on_disk: int, compiled: int, capfd: pytest.CaptureFixture[str]
) -> None:
    (line,) = _log(capfd, on_disk=on_disk)
    assert "compiles" in line
    assert f"functions={compiled}" in line


def test_with_all_on_disk_nothing_is_logged(capfd: pytest.CaptureFixture[str]) -> None:
    assert _log(capfd, on_disk=3) == []
