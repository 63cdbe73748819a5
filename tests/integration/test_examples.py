"""The examples do what they say, beside a real replay."""

import re
import signal
import time
from pathlib import Path

import pytest

from camber.replay.short_drive import write_short_drive
from camber.schemas.channels import BY_NAME
from support.running import endpoint_of, free_port, kill, process_ids, started, wait_until

CONSUMER = Path(__file__).parents[2] / "examples" / "consumer.py"
USABLE = re.compile(r"3[45]\.\d{8} 13[67]\.\d{8} within \d+\.\d\d m by (rtk|sensors)")
ANY_LEVEL = ("--set", "alert_limit_m=50")
"""Without a LiDAR the levels of so short a drive are metres: what matters here is which messages arrive."""
SILENCE = "unknown (nothing new: the last position is too old)"


pytestmark = [pytest.mark.slow, pytest.mark.timed]


def test_a_consumer_prints_positions_and_says_unknown_when_there_are_none(tmp_path):
    drive, out = write_short_drive(tmp_path / "drive"), tmp_path / "out"
    printed = tmp_path / "consumer.txt"
    with started(
        "-m",
        "camber.cli",
        "replay",
        drive,
        "--processes",
        "--out",
        out,
        "--speed",
        4,
        "--set",
        "end_s=12",
        *ANY_LEVEL,
        "--quiet",
    ) as replay:
        endpoint = endpoint_of(out)
        with (
            printed.open("w") as file,
            started(
                CONSUMER, "--vehicle", "demo", "--connect", endpoint, "--replay", stdout=file
            ) as consumer,
        ):
            assert replay.wait(120.0) == 0
            time.sleep(BY_NAME["position"].max_age_s + 0.5)
            assert consumer.poll() is None, "it waits for the vehicle to come back"
            consumer.send_signal(signal.SIGINT)
            consumer.wait(10.0)
    lines = printed.read_text().splitlines()
    assert sum(USABLE.fullmatch(line) is not None for line in lines) > 10
    assert all(USABLE.fullmatch(line) or line.startswith("unknown (") for line in lines), lines
    assert lines[-1] == SILENCE
    assert lines.count(SILENCE) == 1


def test_a_consumer_stops_trusting_the_last_position_when_the_judge_is_gone(tmp_path):
    drive, out = write_short_drive(tmp_path / "drive"), tmp_path / "out"
    printed = tmp_path / "consumer.txt"
    with started(
        "-m",
        "camber.cli",
        "replay",
        drive,
        "--processes",
        "--out",
        out,
        "--speed",
        3,
        "--set",
        "end_s=20",
        *ANY_LEVEL,
        "--quiet",
    ) as replay:
        endpoint = endpoint_of(out)
        with (
            printed.open("w") as file,
            started(
                CONSUMER, "--vehicle", "demo", "--connect", endpoint, "--replay", stdout=file
            ) as consumer,
        ):
            deadline = time.monotonic() + 120.0
            while "by rtk" not in printed.read_text():
                assert time.monotonic() < deadline
                time.sleep(0.05)
            kill(process_ids(out)["integrity"], signal.SIGSTOP)
            while SILENCE not in printed.read_text():
                assert time.monotonic() < deadline
                time.sleep(0.05)
            kill(process_ids(out)["integrity"], signal.SIGCONT)
            replay.wait(120.0)
            consumer.send_signal(signal.SIGINT)
            consumer.wait(10.0)


def test_a_consumer_prints_unknown_before_the_first_message(tmp_path):
    printed = tmp_path / "consumer.txt"
    with (
        printed.open("w") as file,
        started(CONSUMER, "--connect", f"tcp/127.0.0.1:{free_port()}", stdout=file, stderr=file) as consumer,
    ):
        wait_until(printed.read_text, timeout_s=30.0, why="it says nothing")
        consumer.send_signal(signal.SIGINT)
        consumer.wait(10.0)
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
