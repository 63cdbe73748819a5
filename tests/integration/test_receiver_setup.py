"""`camber gnss setup` with receivers at the other end of a pseudo-terminal, which answer as pyubx2 reads and writes."""

from __future__ import annotations

import os
import struct
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from pyubx2 import SET, UBXMessage, UBXReader
from pyubx2.ubxtypes_configdb import UBX_CONFIG_DATABASE

from camber.tools.gnss.setup import main

NAMES = {key: name for name, (key, _) in UBX_CONFIG_DATABASE.items()}
NAV_PL = 0x20910415
NOISE = b"\x00\xb5garbage$R\xd3"


class Terminal(threading.Thread):
    """The receiver's end of a terminal: hands what is written to a function, and its answer back."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        super().__init__(daemon=True)
        self._end, other = os.openpty()
        tty.setraw(other)
        self.address = f"serial:{os.ttyname(other)}"
        self._other = other
        self._answer = answer

    def run(self) -> None:
        """Until the terminal is closed."""
        while True:
            try:
                data = os.read(self._end, 4096)
            except OSError:
                return
            if answer := self._answer(data):
                os.write(self._end, NOISE + answer)

    def close(self) -> None:
        """End the thread first: the number of a file that it still reads may be that of the next terminal."""
        os.close(self._other)
        self.join()
        os.close(self._end)


@contextmanager
def terminal(answer: Callable[[bytes], bytes]) -> Iterator[str]:
    receiver = Terminal(answer)
    receiver.start()
    try:
        yield receiver.address
    finally:
        receiver.close()


class Ublox:
    """Knows all keys but the protection level's, as firmware before HPG 1.32, and has no flash memory."""

    def __init__(self) -> None:
        self.values = {"CFG_RATE_MEAS": 1000, "CFG_NAVSPG_DYNMODEL": 4}
        self.layers: list[int] = []

    def answer(self, data: bytes) -> bytes:
        message_id, payload = data[3], data[6:-2]
        if message_id == 0x8B:
            (key,) = struct.unpack("<I", payload[4:8])
            if NAV_PL <= key <= NAV_PL + 3:
                return UBXMessage("ACK", "ACK-NAK", 0, clsID=6, msgID=0x8B).serialize()
            value = self.values.get(NAMES[key], 0)
            size = {1: 1, 2: 1, 3: 2, 4: 4}[key >> 28]
            return UBXMessage(
                b"\x06", b"\x8b", 0, payload=b"\x01\0\0\0" + payload[4:8] + value.to_bytes(size, "little")
            ).serialize()
        parsed = UBXReader.parse(data, msgmode=SET)
        self.layers.append(payload[1])
        if payload[1] & 4:
            return UBXMessage("ACK", "ACK-NAK", 0, clsID=6, msgID=0x8A).serialize()
        self.values |= {name: getattr(parsed, name) for name in NAMES.values() if hasattr(parsed, name)}
        return UBXMessage("ACK", "ACK-ACK", 0, clsID=6, msgID=0x8A).serialize()


class Septentrio:
    """Keeps what was set, and refuses what it does not know."""

    def __init__(self) -> None:
        self.lines = {"ReceiverDynamics": "ReceiverDynamics, Moderate, Automotive"}
        self.commands: list[str] = []

    def answer(self, data: bytes) -> bytes:
        command = data.decode().strip()
        self.commands.append(command)
        action, _, arguments = command.partition(", ")
        name = action[3:]
        key = name + arguments.partition(", ")[0] * (name != "ReceiverDynamics")
        if name == "CopyConfigFile":
            return f"$R: {command}\r\n  CopyConfigFile, Current, Boot\r\nUSB1>".encode()
        if action.startswith("set"):
            if "GALAuthStatus" in arguments:
                return b"$R? setSBFOutput: Argument 'blocks' is invalid!\r\nUSB1>"
            self.lines[key] = f"{name}, {arguments}"
        return f"$R: {command}\r\n  {self.lines.get(key, name + ', none')}\r\nUSB1>".encode()


def test_a_ublox_receiver_is_compared_and_left_alone_without_consent(
    capsys: pytest.CaptureFixture[str],
) -> None:
    receiver = Ublox()
    with terminal(receiver.answer) as address:
        assert main(["ublox", "--port", address]) == 0
    output = capsys.readouterr().out
    assert "measurement period [ms]: 1000 -> 200" in output
    assert "NAV-PL on USB, each n-th epoch: not known to this receiver" in output
    assert "dynamic model" not in output
    assert "nothing was changed" in output
    assert receiver.layers == []


def test_a_ublox_receiver_is_set_where_it_can_keep_it_and_read_back(
    capsys: pytest.CaptureFixture[str],
) -> None:
    receiver = Ublox()
    with terminal(receiver.answer) as address:
        assert main(["ublox", "--port", address, "--yes", "--rate-hz", "10"]) == 0
        assert "were changed and read back" in capsys.readouterr().out
        assert main(["ublox", "--port", address, "--yes", "--rate-hz", "10"]) == 0
    assert receiver.layers == [7, 3]
    assert receiver.values["CFG_RATE_MEAS"] == 100
    assert receiver.values["CFG_MSGOUT_UBX_RXM_RAWX_USB"] == 1
    assert "are as Camber needs them" in capsys.readouterr().out


def test_a_septentrio_receiver_that_refuses_a_setting_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    receiver = Septentrio()
    with terminal(receiver.answer) as address:
        assert main(["septentrio", "--port", address]) == 0
        output = capsys.readouterr().out
        assert "SBFOutput, none -> SBFOutput, Stream1, USB1, MeasEpoch, msec200" in output
        assert not [command for command in receiver.commands if not command.startswith("get")]
        assert main(["septentrio", "--port", address, "--yes", "--volatile"]) == 2
    error = capsys.readouterr().err
    assert "the receiver refuses it: setSBFOutput: Argument 'blocks' is invalid!" in error
    assert error.count("\n") == 1
    assert not [command for command in receiver.commands if command.startswith("exe")]


def test_a_port_that_does_not_answer_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with terminal(lambda _: b"") as address:
        assert main(["ublox", "--port", address]) == 2
    assert "no answer, expected one of a u-blox receiver" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("address", "expected"),
    [("serial:/dev/nothing", "/dev/nothing"), ("usb0", "expected serial:DEVICE[:BAUD] or tcp:HOST:PORT")],
)
def test_a_port_that_is_not_there_is_one_line(
    address: str, expected: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["ublox", "--port", address]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
