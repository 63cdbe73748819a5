"""An upload reaches its service with the vehicle that its key names, live and in a replay, at its own time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from random import Random
from typing import Any

import pytest
import zenoh

from camber.replay.lock_step.service_loop import LockStepBus, LockStepLoop
from camber.runtime.bus import Bus
from camber.runtime.clock import ReplayClock, SystemClock
from camber.runtime.run import Loop
from camber.runtime.service import Service
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.runtime.uploads.received_upload import ReceivedUpload
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import decode, encode, encoding_of
from camber.schemas.fleet import ElevationUpload, UploadReceipt
from support.messages import build
from support.running import free_port

MESSAGE = build(ElevationUpload, Random(7))


class Server(Service[ServiceSettings]):
    """Says what it got."""

    NAME = "map_update"
    SETTINGS = ServiceSettings

    def __init__(self, settings: ServiceSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self.got: list[tuple[str, int]] = []

    def answers(self) -> dict[str, Callable[[Sequence[Any]], Sequence[Any]]]:
        return {"upload": self.take}

    def take(self, uploads: Sequence[ReceivedUpload]) -> list[UploadReceipt]:
        self.got += [(upload.vehicle, self.bus.now_ns()) for upload in uploads]
        return [
            UploadReceipt(
                time_ns=upload.time_ns,
                vehicle=upload.message.vehicle,
                upload_id=upload.message.upload_id,
                status="stored",
            )
            for upload in uploads
        ]


@contextmanager
def server_and_client(*, replayed: bool = False) -> Iterator[tuple[Server, Loop, zenoh.Session]]:
    """A service of the fleet that answers uploads, and one who sends them."""
    clock = ReplayClock() if replayed else SystemClock()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    zenoh_settings = ZenohSettings(mode="router", connect=[], listen=[endpoint])
    settings = ServiceSettings(vehicle="fleet", zenoh=zenoh_settings, log_level="error")
    bus_class, loop_class = (LockStepBus, LockStepLoop) if replayed else (Bus, Loop)
    bus = bus_class(open_session(settings.zenoh), settings, "map_update", clock)
    client = open_session(ZenohSettings(mode="client", connect=[endpoint]))
    try:
        service = Server(settings, bus)
        loop = loop_class(service, bus, clock)
        bus.answer(BY_NAME["upload"])
        yield service, loop, client
    finally:
        client.close()
        bus.close()


def answered(loop: Loop, client: zenoh.Session, key: str) -> list[zenoh.Reply]:
    payload, encoding = encode(MESSAGE, source="test"), encoding_of(ElevationUpload)
    replies = client.get(key, payload=payload, encoding=encoding, timeout=10.0)
    assert loop.bus.next_event(10.0) == ("query", "upload")
    loop.answer("upload")
    return list(replies)


@pytest.mark.parametrize("replayed", [False, True], ids=["live", "in a replay"])
def test_an_upload_comes_with_the_vehicle_of_its_key(replayed: bool) -> None:
    with server_and_client(replayed=replayed) as (service, loop, client):
        replies = answered(loop, client, "camber/v1/fleet/car-7/upload")
        (receipt,) = [
            decode(UploadReceipt, each.ok.payload.to_bytes()).message for each in replies if each.ok
        ]
        assert receipt.upload_id == MESSAGE.upload_id
        ((vehicle, at_ns),) = service.got
        assert vehicle == "car-7"
        assert not replayed or at_ns == MESSAGE.time_ns


@pytest.mark.parametrize("key", ["camber/v1/fleet/**", "camber/v1/**", "camber/v1/fleet/*/upload"])
def test_an_upload_that_is_asked_of_many_vehicles_is_refused_and_the_service_goes_on(key: str) -> None:
    with server_and_client() as (service, loop, client):
        replies = answered(loop, client, key)
        (error,) = [reply.err.payload.to_bytes().decode() for reply in replies if reply.err]
        assert f"key '{key}': expected camber/v1/fleet/{{vehicle}}/upload of one vehicle" in error
        assert service.got == []
        assert [issue.code for issue in loop.bus.issues()] == ["refused_question"]
