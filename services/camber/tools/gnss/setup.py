"""`camber gnss setup`: configure a receiver as Camber needs it.

The receiver is asked for its settings first, and what would change is printed. With --yes the changes are made, kept
by the receiver without power unless --volatile is given, and read back.
"""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from camber.formats.receiver.frame_buffer import FrameBuffer
from camber.formats.receiver.septentrio_commands import (
    SeptentrioReply,
    SeptentrioSetting,
    keep_command,
    parse_reply,
    wanted_settings,
)
from camber.formats.ubx.configuration import (
    BATTERY_BACKED,
    FLASH,
    RAM,
    UBX_PORTS,
    UbxPort,
    is_acknowledged,
    key_name,
    read_values,
    value_request,
    value_setting,
    wanted_values,
)
from camber.schemas.toml_file import FileError
from camber.tools.options.error_report import report_failures
from camber.tools.options.parsers import add_with_default, tool_parser
from camber.transport.byte_streams import ByteSource, parse_source

T = TypeVar("T")
_PROG = "camber gnss setup"
_ANSWER_S = 1.5
"""Chosen: answers come within 0.1 s, and one may be lost among observations at 115200 baud and be asked for again."""
_TRIES = 2  # chosen: of two requests one arrives


class ReceiverError(FileError):
    """The receiver does not answer, or refuses; one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SettingChange:
    """One setting: what the receiver has, None where it does not know it, and what Camber needs."""

    name: str
    now: str | None
    wanted: str

    @property
    def is_needed(self) -> bool:
        """Whether it differs, and the receiver knows it."""
        return self.now is not None and self.now != self.wanted

    def describe(self) -> str:
        """One line for people."""
        if self.now is None:
            return f"  {self.name}: not known to this receiver"
        return f"  {self.name}: {self.now} -> {self.wanted}"


class ReceiverSetup(Protocol):
    """A receiver that can be asked and set."""

    def changes(self) -> list[SettingChange]:
        """Ask for all settings."""

    def apply(self, *, volatile: bool) -> None:
        """Set those that were asked for and differ."""


def main(argv: Sequence[str]) -> int:
    """Configure one receiver; 0 done or nothing to do, 2 no such port, no answer or a refusal."""
    parser = _parser()
    args = parser.parse_args(argv)

    def work() -> str:
        try:
            with closing(_open(args.port)) as port:
                return configure(_setup_of(args, port), apply=args.yes, volatile=args.volatile)
        except ValueError as error:
            if isinstance(error, ReceiverError):
                raise
            raise ReceiverError(str(error)) from None

    return report_failures(_PROG, Path(args.port), work)


def configure(setup: ReceiverSetup, *, apply: bool, volatile: bool) -> str:
    """Ask, print what differs, set it if wanted, and read it back; returns the report. Raises ReceiverError."""
    before = setup.changes()
    needed = [change for change in before if change.is_needed]
    unknown = [change for change in before if change.now is None]
    lines = [change.describe() for change in (*needed, *unknown)]
    if not needed:
        return "\n".join([*lines, f"{len(before) - len(unknown)} settings are as Camber needs them"])
    if not apply:
        return "\n".join(
            [*lines, f"{len(needed)} settings would change; nothing was changed (--yes changes them)"]
        )
    setup.apply(volatile=volatile)
    left = [change for change in setup.changes() if change.is_needed]
    if left:
        raise ReceiverError(
            f"{left[0].name}: the receiver has {left[0].now} still, expected {left[0].wanted}"
        )
    kept = "until it loses power" if volatile else "also without power"
    return "\n".join([*lines, f"{len(needed)} settings were changed and read back; they hold {kept}"])


class UbloxSetup:
    """A u-blox receiver from generation 9 on, at one of its ports."""

    def __init__(self, port: ByteSource, ubx_port: UbxPort, rate_hz: int, *, raw: bool) -> None:
        self._port = port
        self._wanted = wanted_values(ubx_port, rate_hz, raw=raw)
        self._needed: dict[int, int] = {}

    def changes(self) -> list[SettingChange]:
        """Ask for each key by itself: one that the receiver does not know costs no others."""
        now = {key: self._value(key) for key in self._wanted}
        self._needed = {
            key: value for key, value in self._wanted.items() if now[key] is not None and now[key] != value
        }
        return [
            SettingChange(
                name=key_name(key), now=None if now[key] is None else str(now[key]), wanted=str(value)
            )
            for key, value in self._wanted.items()
        ]

    def apply(self, *, volatile: bool) -> None:
        """Set all at once; without flash memory in what the receiver has."""
        if volatile:
            accepted = self._set(RAM)
        else:
            accepted = self._set(RAM | BATTERY_BACKED | FLASH) or self._set(RAM | BATTERY_BACKED)
        if not accepted:
            raise ReceiverError("the receiver refuses the settings (CFG-VALSET)")

    def _value(self, key: int) -> int | None:
        def answer(frame: bytes) -> tuple[int | None] | None:
            values = read_values(frame)
            if values is not None and key in values:
                return (values[key],)
            return (None,) if is_acknowledged(frame, setting=False) is False else None

        return self._exchange(value_request(key), answer, key_name(key))[0]

    def _set(self, layers: int) -> bool:
        return self._exchange(
            value_setting(self._needed, layers),
            lambda frame: is_acknowledged(frame, setting=True),
            "CFG-VALSET",
        )

    def _exchange(self, request: bytes, answer: Callable[[bytes], T | None], what: str) -> T:
        """The first answer that is not None; asks again where none comes."""
        for _ in range(_TRIES):
            frames = FrameBuffer("ubx")
            for data in _received(self._port, request):
                for frame in frames.feed(data):
                    result = answer(frame.data)
                    if result is not None:
                        return result
            for frame in frames.finish():  # what looked like the beginning of a long message was none
                result = answer(frame.data)
                if result is not None:
                    return result
        raise ReceiverError(f"{what}: no answer, expected one of a u-blox receiver of generation 9 or later")


class SeptentrioSetup:
    """A Septentrio receiver; it says itself at which of its ports it is."""

    def __init__(self, port: ByteSource, rate_hz: int, *, raw: bool) -> None:
        self._port = port
        name = self._ask("getReceiverDynamics").port
        self._settings = wanted_settings(name, rate_hz, raw=raw)
        self._needed: list[SeptentrioSetting] = []

    def changes(self) -> list[SettingChange]:
        """Ask for each setting."""
        self._needed, changes = [], []
        for setting in self._settings:
            reply = self._ask(setting.ask, may_refuse=True)
            met = setting.is_met(reply)
            if reply.accepted and not met:
                self._needed.append(setting)
            wanted = ", ".join(setting.values)
            now = wanted if met else "; ".join(reply.lines) or "nothing"
            changes.append(
                SettingChange(name=setting.ask, now=now if reply.accepted else None, wanted=wanted)
            )
        return changes

    def apply(self, *, volatile: bool) -> None:
        """Set one after another."""
        for setting in self._needed:
            self._ask(setting.command)
        if not volatile:
            self._ask(keep_command())

    def _ask(self, command: str, *, may_refuse: bool = False) -> SeptentrioReply:
        for _ in range(_TRIES):
            received = b""
            for data in _received(self._port, command.encode("ascii") + b"\r\n"):
                received += data
                reply = parse_reply(received)
                if reply is not None:
                    if reply.accepted or may_refuse:
                        return reply
                    raise ReceiverError(f"{command}: the receiver refuses it: {reply.text}")
        raise ReceiverError(f"{command}: no answer, expected one of a Septentrio receiver")


def _open(address: str) -> ByteSource:
    """Raise ValueError for what is no port that can be written to, OSError where it cannot be opened."""
    if not address.startswith(("serial:", "tcp:")):
        raise ValueError(f"{address!r}: expected serial:DEVICE[:BAUD] or tcp:HOST:PORT")
    return parse_source(address)(threading.Event())


def _received(port: ByteSource, request: bytes) -> Iterator[bytes]:
    """Send a request, and yield what arrives until the time for its answer is over."""
    until_s = time.monotonic() + _ANSWER_S
    if port.send(request) != len(request):
        raise ReceiverError("the port has not taken the whole request")
    while time.monotonic() < until_s:
        yield port.read()


def _setup_of(args: argparse.Namespace, port: ByteSource) -> ReceiverSetup:
    raw = args.positions == "engine"
    if args.maker == "ublox":
        return UbloxSetup(port, args.receiver_port, args.rate_hz, raw=raw)
    return SeptentrioSetup(port, args.rate_hz, raw=raw)


def _rate_hz(text: str) -> int:
    """Raise ArgumentTypeError for a rate that is no whole number of times a second that divides it."""
    if not text.isdecimal() or not 1 <= int(text) <= 100 or 1000 % int(text):
        raise argparse.ArgumentTypeError(f"{text!r}, expected a divisor of 1000 from 1 to 100")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    parser = tool_parser(_PROG, __doc__)
    add = parser.add_argument
    add("maker", choices=("ublox", "septentrio"), help="maker of the receiver")
    add("--port", required=True, metavar="ADDRESS", help="serial:DEVICE[:BAUD] or tcp:HOST:PORT")
    add_with_default(
        parser, "--positions", "engine", "raw observations for Camber's engine, or positions of the receiver",
        choices=("engine", "receiver"),
    )  # fmt: skip
    add_with_default(parser, "--rate-hz", 5, "epochs a second", type=_rate_hz)
    add_with_default(
        parser, "--receiver-port", "usb", "port of a u-blox receiver that is connected", choices=UBX_PORTS
    )
    add("--yes", action="store_true", help="change the settings; without it they are only compared")
    add("--volatile", action="store_true", help="only until the receiver loses power")
    return parser
