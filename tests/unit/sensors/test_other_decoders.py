"""Other programs read the simulator's recordings as Camber does; run where CAMBER_ORACLES names a Python with them."""

import io
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from camber.formats.lidar_can.candump import CandumpDecoder, CanFrame, candump_text
from camber.formats.lidar_can.dbc import read_dbc
from camber.formats.lidar_can.pcap import PcapDecoder
from camber.sensors.inputs import gps_ns
from camber.simulator.output.can_frames import DBC
from camber.simulator.output.lidar_packets import ouster_metadata, pcap_of
from support.tree import ROOT
from unit.sensors.test_lidar_reader import read, reader, sweeps

PYTHON = os.environ.get("CAMBER_ORACLES")
pytestmark = pytest.mark.skipif(
    not PYTHON,
    reason="CAMBER_ORACLES names no Python with velodyne-decoder, ouster-sdk, cantools (decision 6)",
)


def asked(*arguments: object) -> bytes:
    script = ROOT / "tests" / "support" / "oracles_of_sensors.py"
    done = subprocess.run(
        [str(PYTHON), str(script), *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


def recorded(folder: Path, kind: str) -> tuple[Path, list]:
    path = folder / "lidar.pcap"
    path.write_bytes(b"".join(pcap_of(sweeps(kind), kind)))
    packets = PcapDecoder("lidar.pcap").feed(path.read_bytes())
    result, issues, _ = read(reader(kind), [(gps_ns(one.time_ns), one.payload) for one in packets])
    assert issues == []
    return path, result


def test_velodyne_decoder_has_the_same_points(tmp_path: Path) -> None:
    path, result = recorded(tmp_path, "velodyne")
    theirs = np.load(io.BytesIO(asked("velodyne", path)))
    ours = np.concatenate([sweep.points_m for sweep in result])
    assert theirs.shape == ours.shape
    far_m = np.linalg.norm(ours, axis=1)
    # It rounds azimuths to 0.01°, and elevations to two decimals.
    assert (np.linalg.norm(theirs - ours, axis=1) <= np.radians(0.013) * far_m + 1e-4).all()


def test_ouster_sdk_has_the_same_points_and_times(tmp_path: Path) -> None:
    path, result = recorded(tmp_path, "ouster")
    (tmp_path / "m.json").write_text(ouster_metadata())
    theirs = np.load(io.BytesIO(asked("ouster", path, tmp_path / "m.json")))
    ours = np.concatenate([sweep.points_m for sweep in result])
    np.testing.assert_allclose(theirs["points"], ours, atol=1e-5)
    times_ns = np.unique(
        np.concatenate([sweep.time_ns + sweep.offset_ns.astype(np.int64) for sweep in result])
    )
    tai_ns = times_ns + (315_964_800 + 19) * 1_000_000_000
    assert np.isin(tai_ns, theirs["stamps"].astype(np.int64)).all()


def test_cantools_has_the_same_values(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    messages = read_dbc(DBC, "can.dbc")
    frames = []
    for k in range(300):
        message = list(messages.values())[k % len(messages)]
        (signal,) = message.signals.values()
        data = signal.placed(int(rng.integers(-32768, 32768)), rng.bytes(message.length_bytes))
        identity = {"identifier": message.identifier, "extended": message.extended}
        frames.append(CanFrame(time_ns=1_700_000_000_000_000_000, bus="can0", data=data, **identity))
    (tmp_path / "can.log").write_text(candump_text(frames))
    (tmp_path / "can.dbc").write_text(DBC)
    theirs = asked("can", tmp_path / "can.log", tmp_path / "can.dbc").decode().splitlines()
    by_identifier = {(one.identifier, one.extended): one for one in messages.values()}
    ours = []
    for frame in CandumpDecoder("can.log").feed((tmp_path / "can.log").read_bytes()):
        message = by_identifier[frame.identifier, frame.extended]
        for name, signal in message.signals.items():
            raw = signal.raw(frame.data)
            assert raw is not None
            ours.append((message.name, name, raw * signal.factor + signal.offset))
    assert len(theirs) == len(ours) == 300
    for line, (message_name, name, value) in zip(theirs, ours, strict=True):
        their_message, their_name, theirs = line.split()
        assert (their_message, their_name) == (message_name, name)
        assert float(theirs) == pytest.approx(value, abs=1e-9)
