"""The examples do what they say, beside a real replay."""

from __future__ import annotations

import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from camber.replay.short_drive import write_short_drive
from camber.schemas.channels import BY_NAME
from support.running import (
    endpoint_of,
    free_endpoint,
    kill,
    process_ids,
    replaying,
    started,
    wait_until,
)

CONSUMER = Path(__file__).parents[2] / "examples" / "consumer.py"
USABLE = re.compile(r"3[45]\.\d{8} 13[67]\.\d{8} within \d+\.\d\d m by (rtk|sensors)")
ANY_LEVEL = ("--set", "alert_limit_m=50")
"""Without a LiDAR the levels of so short a drive are metres: what matters here is which messages arrive."""
SILENCE = "unknown (nothing new: the last position is too old)"

pytestmark = [pytest.mark.slow, pytest.mark.timed]


@contextmanager
def consumer(printed: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """The example, which prints into a file until it is interrupted."""
    with printed.open("w") as file, started(CONSUMER, *arguments, stdout=file) as process:
        yield process
        assert process.poll() is None, "it waits for the vehicle to come back"
        process.send_signal(signal.SIGINT)
        process.wait(10.0)


@contextmanager
def of_a_replay(folder: Path, end_s: float, speed: float) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """A replay whose positions a consumer prints into the file `consumer.txt` of the folder; its process and folder."""
    out = folder / "out"
    with replaying(write_short_drive(folder / "drive"), out, end_s, speed, *ANY_LEVEL) as replay:
        vehicle = ("--vehicle", "demo", "--connect", endpoint_of(out), "--replay")
        with consumer(folder / "consumer.txt", *vehicle):
            yield replay, out


def test_a_consumer_prints_positions_and_says_unknown_when_there_are_none(tmp_path):
    with of_a_replay(tmp_path, 12.0, 4.0) as (replay, _):
        assert replay.wait(120.0) == 0
        time.sleep(BY_NAME["position"].max_age_s + 0.5)
    lines = (tmp_path / "consumer.txt").read_text().splitlines()
    assert sum(USABLE.fullmatch(line) is not None for line in lines) > 10
    assert all(USABLE.fullmatch(line) or line.startswith("unknown (") for line in lines), lines
    assert lines[-1] == SILENCE
    assert lines.count(SILENCE) == 1


def test_a_consumer_stops_trusting_the_last_position_when_the_judge_is_gone(tmp_path):
    printed = tmp_path / "consumer.txt"
    with of_a_replay(tmp_path, 20.0, 3.0) as (replay, out):
        wait_until(lambda: "by rtk" in printed.read_text(), timeout_s=120.0, why="no position of RTK")
        kill(process_ids(out)["integrity"], signal.SIGSTOP)
        wait_until(lambda: SILENCE in printed.read_text(), timeout_s=120.0, why="it trusts the last position")
        kill(process_ids(out)["integrity"], signal.SIGCONT)
        replay.wait(120.0)


def test_a_consumer_prints_unknown_before_the_first_message(tmp_path):
    printed = tmp_path / "consumer.txt"
    with consumer(printed, "--connect", free_endpoint()):
        wait_until(printed.read_text, timeout_s=30.0, why="it says nothing")
    assert printed.read_text() == "unknown (no position yet)\n"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--vehicle", "a b"], "vehicle: "),
        (["--vehicle", ""], "vehicle: "),
        (["--connect", "127.0.0.1:7447"], "connect/endpoints: "),
        (["--connect", "tls/router:7447"], "tls_ca"),
    ],
)
def test_a_wrong_argument_of_a_consumer_is_one_line(arguments, named):
    with started(CONSUMER, *arguments) as consumer:
        output, _ = consumer.communicate(timeout=30.0)
    line = output.splitlines()[-1]
    assert consumer.returncode != 0
    assert line.startswith("consumer.py: ")
    assert named in line
    assert "Traceback" not in output
