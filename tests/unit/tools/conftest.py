"""What tests of several tools need: a router, recordings, a short drive, and a command's refusal."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from camber.replay.short_drive import write_short_drive
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from support.refusals import Refused, refusal
from support.running import free_port


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Refused:
    return functools.partial(refusal, capsys)


@pytest.fixture
def endpoint() -> Iterator[str]:
    """Of a router in this process."""
    where = f"tcp/127.0.0.1:{free_port()}"
    with open_session(ZenohSettings(mode="router", listen=[where], connect=[])):
        yield where


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of recordings."""
    if not os.environ.get("CAMBER_DATA"):
        pytest.skip("CAMBER_DATA is not set: the recordings are not here")
    return Path(os.environ["CAMBER_DATA"])


@pytest.fixture(scope="session")
def blind(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two minutes without a LiDAR."""
    return write_short_drive(tmp_path_factory.mktemp("short") / "drive", 1)
