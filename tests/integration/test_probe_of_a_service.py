"""The probe that containers run: well, waiting, frozen, gone."""

import signal
from pathlib import Path

from support.running import free_endpoint, loopback_router, python, settings_file, started, wait_until


def probed(service: str, settings: Path) -> tuple[int, str]:
    done = python("-m", "camber.runtime.health.probe", service, settings, timeout_s=30.0)
    return done.returncode, done.stdout.strip()


def test_a_service_is_well_until_it_freezes(tmp_path: Path) -> None:
    settings = tmp_path / "antenna_height.toml"
    height = ('way = "fixed"', "fixed_height_m = 1.6", "fixed_sigma_m = 0.01")
    endpoint = free_endpoint()
    settings_file(settings, endpoint, *height)
    assert probed("router", settings)[0] == 1
    with (
        loopback_router(endpoint),
        (tmp_path / "log").open("w") as log,
        started("-m", "camber.antenna_height", "--config", settings, stdout=log) as service,
    ):
        wait_until(
            lambda: probed("antenna_height", settings) == (0, "antenna_height: ok"),
            timeout_s=60.0,
            why="antenna_height does not say that it is well",
        )
        assert probed("router", settings) == (0, "router: ok")
        service.send_signal(signal.SIGSTOP)
        code, output = probed("antenna_height", settings)
        service.send_signal(signal.SIGCONT)
        assert code == 1
        assert output.startswith("antenna_height: no answer: ")
