"""Who is there, asked of a router that is linked to another: told every time, though Zenoh itself may be silent."""

from __future__ import annotations

import time

import pytest

from camber.runtime.ask import Asker
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from support.fleet_routers import (
    HOST,
    cloud_file,
    make_certificates,
    router,
    tls_endpoint,
    vehicle_file,
)
from support.running import free_port, wait_until


@pytest.mark.slow
def test_who_is_there_is_told_every_time_and_who_has_left_is_not(tmp_path) -> None:
    certificates, cloud = make_certificates(tmp_path), tls_endpoint()
    inside = f"tcp/{HOST}:{free_port()}"
    file = vehicle_file(certificates, "car-1", inside, tmp_path / "car-1.json5", cloud)
    with router(cloud_file(certificates, cloud, tmp_path / "cloud.json5")), router(file) as vehicle:
        wait_until(lambda: "heard as" in vehicle.said, timeout_s=60.0, why="no link")
        bus = ZenohSettings(mode="client", connect=[inside])
        with open_session(bus) as service:
            tokens = [
                service.liveliness().declare_token(f"camber/v1/car-1/{name}/alive")
                for name in ("gnss", "integrity")
            ]
            time.sleep(0.5)
            with Asker(ServiceSettings(vehicle="car-1", zenoh=bus), timeout_s=3.0) as asker:
                told = [asker.alive("car-1") for _ in range(12)]
                assert told == [{"car-1": frozenset({"gnss", "integrity"})}] * 12
                assert asker.alive("car-2") == {}
                tokens[0].undeclare()
                left = {"car-1": frozenset({"integrity"})}
                wait_until(lambda: asker.alive() == left, timeout_s=20.0, why="who has left is still there")
