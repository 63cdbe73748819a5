"""`camber upload`: a file goes to the store, each batch once, and each file gets its result."""

import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from camber.schemas.codec import decode, encode, encoding_of
from camber.schemas.fleet import UploadBatch, UploadReceipt
from support.running import camber, camber_started, free_endpoint, loopback_router, wait_until
from support.tree import ROOT

EXAMPLE = ROOT / "examples" / "uploads.csv"


@pytest.fixture
def cloud(tmp_path: Path) -> Iterator[str]:
    with loopback_router() as endpoint, (tmp_path / "log").open("w") as log:
        bus = ("--vehicle", "fleet", "--zenoh.connect", f'["{endpoint}"]')
        with camber_started("map_update", *bus, "--state-dir", tmp_path / "state", stdout=log):
            yield endpoint


def test_files_are_acknowledged_and_what_comes_again_is_known(tmp_path: Path, cloud: str) -> None:
    other = tmp_path / "other.csv"
    other.write_text(EXAMPLE.read_text().replace("monday", "tuesday"))
    first = camber("upload", EXAMPLE, other, "--connect", cloud)
    assert first.returncode == 0, first.stderr
    assert first.stdout.splitlines() == [
        f"{path}: 12 observations in 3 batches: 12 stored" for path in (EXAMPLE, other)
    ]
    stored = camber("uploads", tmp_path / "state/uploads.sqlite", "--records").stdout
    assert len(stored.splitlines()) == 1 + 24
    # What the store gives is what it takes.
    again = tmp_path / "again.csv"
    again.write_text(stored)
    second = camber("upload", again, "--connect", cloud)
    assert (second.returncode, second.stdout) == (
        0,
        f"{again}: 24 observations in 6 batches: 24 duplicate\n",
    ), second.stderr


def test_what_is_refused_or_wrong_says_so(tmp_path: Path, cloud: str) -> None:
    foreign = tmp_path / "foreign.csv"
    foreign.write_text(EXAMPLE.read_text().replace("ITRF2014", "NAD83"))
    refused = camber("upload", foreign, "--connect", cloud)
    assert refused.returncode == 1
    assert "12 refused" in refused.stdout
    assert "car-1 monday-1: refused: datum NAD83, expected one of" in refused.stderr
    foreign.write_text(EXAMPLE.read_text().replace(",fixed,", ",firm,", 1))
    wrong = camber("upload", EXAMPLE, foreign, "--connect", cloud)
    assert wrong.returncode == 2
    assert (wrong.stdout, wrong.stderr.count("\n")) == ("", 1), "nothing is sent where one file is wrong"


def test_interrupted_it_says_what_is_stored() -> None:
    """A store that takes one batch, and is silent then."""
    endpoint, key = free_endpoint(), "camber/v1/fleet/*/upload_batch"
    asked: list[zenoh.Query] = []

    def one(query: zenoh.Query) -> None:
        asked.append(query)
        if len(asked) > 1 or query.payload is None:
            return
        batch = decode(UploadBatch, query.payload.to_bytes()).message
        receipt = UploadReceipt(
            time_ns=batch.time_ns, vehicle=batch.vehicle, upload_id=batch.batch_id, status="stored"
        )
        with query:
            query.reply(
                query.key_expr, encode(receipt, source="map_update"), encoding=encoding_of(UploadReceipt)
            )

    with open_session(ZenohSettings(mode="router", listen=[endpoint], connect=[])) as store:
        store.declare_queryable(key, one)
        with camber_started("upload", EXAMPLE, "--connect", endpoint, stderr=subprocess.PIPE) as process:
            wait_until(lambda: len(asked) > 1, timeout_s=30.0, why="the second batch does not come")
            process.send_signal(signal.SIGINT)
            output, why = process.communicate(timeout=30.0)
        asked.clear()
    assert (process.returncode, why) == (130, "camber upload: interrupted\n")
    assert output == f"{EXAMPLE}: 4 observations in 1 of 3 batches: 4 stored\n"


def test_nobody_there_is_one_line() -> None:
    alone = camber("upload", EXAMPLE, "--timeout", "1", "--connect", free_endpoint())
    assert (alone.returncode, alone.stdout) == (1, "")
    assert alone.stderr.startswith("camber upload: cannot join the bus")
    assert alone.stderr.count("\n") == 1
