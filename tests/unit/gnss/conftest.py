"""A short simulated drive whose raw observations several tests read."""

from __future__ import annotations

import pytest

from support.raw_drive import RawDrive


@pytest.fixture(scope="session")
def raw_drive(tmp_path_factory: pytest.TempPathFactory) -> RawDrive:
    return RawDrive(tmp_path_factory.mktemp("raw") / "drive")
