"""Services of a replay are started, started again when they end, and ended; their settings reach them whole."""

import json
import os
import signal
import tomllib
from pathlib import Path

import pytest

from camber.replay.lock_step.processes import Processes
from camber.schemas.drive import ManifestError
from support.streams import wait_for

ENDPOINT = "tcp/127.0.0.1:9"  # nobody listens there; a service waits for it and does nothing else


def config(folder, **changed):
    zenoh = {"mode": "peer", "connect": [ENDPOINT], "listen": ["tcp/127.0.0.1:0"]}
    return {"vehicle": "car", "clock": "replay", "state_dir": folder / "state", **changed, "zenoh": zenoh}


def pids(folder) -> dict[str, int]:
    return json.loads((folder / "processes.json").read_text())


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture
def processes(tmp_path):
    one = Processes(folder=tmp_path, configs={"map_update": config(tmp_path)})
    yield one
    one.stop()


def test_settings_are_written_as_they_were_given(tmp_path):
    given = config(tmp_path, text='a "quoted" \\ word', number=0.25, flag=True, nested={"deep": {"x_m": 1}})
    processes = Processes(folder=tmp_path, configs={"map_update": given})
    processes.start()
    processes.stop()
    read = tomllib.loads((tmp_path / "config" / "map_update.toml").read_text())
    assert read == {**given, "state_dir": str(tmp_path / "state")}


def test_what_is_started_is_named_with_its_process_and_ended_with_the_rest(tmp_path, processes):
    processes.start()
    (pid,) = pids(tmp_path).values()
    assert is_running(pid)
    processes.stop()
    assert not is_running(pid)


def test_a_killed_service_is_started_again_and_noted(tmp_path, processes):
    processes.start()
    (pid,) = pids(tmp_path).values()
    os.kill(pid, signal.SIGKILL)
    wait_for(lambda: processes.restart_ended() or pids(tmp_path)["map_update"] != pid)
    assert is_running(pids(tmp_path)["map_update"])
    assert processes.notes == ["map_update ended (signal SIGKILL) and was started again"]


def test_one_that_runs_is_left_alone(tmp_path, processes):
    processes.start()
    before = pids(tmp_path)
    processes.restart_ended()
    assert pids(tmp_path) == before
    assert processes.notes == []


def test_a_service_with_wrong_settings_says_so_and_is_not_tried_again(tmp_path):
    processes = Processes(folder=tmp_path, configs={"map_update": config(tmp_path, colour="red")})
    processes.start()
    log = tmp_path / "logs" / "map_update.log"
    wait_for(lambda: log.read_text().endswith("\n"))
    path = tmp_path / "config" / "map_update.toml"
    assert log.read_text() == f"camber map_update: {path}: colour: unknown setting\n"
    with pytest.raises(ManifestError, match="colour: unknown setting"):
        wait_for(processes.raise_refused_settings)
    (pid,) = pids(tmp_path).values()
    processes.restart_ended()
    assert (list(pids(tmp_path).values()), processes.notes) == ([pid], [])
    processes.stop()


def test_one_that_does_not_end_when_asked_is_killed(tmp_path, processes):
    processes.start()
    (pid,) = pids(tmp_path).values()
    os.kill(pid, signal.SIGSTOP)
    wait_for(lambda: Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "T")
    processes.stop(timeout_s=0.3)
    assert not is_running(pid)
    assert processes.notes == ["map_update did not end within 0 s and was killed"]


def test_the_environment_of_a_replay_does_not_reach_its_services(tmp_path, processes, monkeypatch):
    monkeypatch.setenv("CAMBER_MAP_UPDATE_VEHICLE", "another")
    processes.start()
    environ = Path(f"/proc/{pids(tmp_path)['map_update']}/environ").read_bytes()
    assert b"CAMBER_" not in environ
