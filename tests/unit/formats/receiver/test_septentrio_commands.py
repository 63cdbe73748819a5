"""Replies of Septentrio receivers among binary blocks, and the settings that Camber needs."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.receiver.septentrio_commands import parse_reply, wanted_settings

exactly = settings(derandomize=True, deadline=None)
REPLY = b"$R: getSBFOutput, Stream1\r\n  SBFOutput, Stream1, USB1, MeasEpoch, msec200\r\nUSB1>"
REFUSAL = b"$R? setSBFOutput: Argument 'blocks' is invalid!\r\nUSB1>"


def test_a_reply_has_its_lines_and_its_port():
    reply = parse_reply(REPLY)
    assert reply.accepted
    assert reply.lines == ("SBFOutput, Stream1, USB1, MeasEpoch, msec200",)
    assert reply.port == "USB1"


def test_a_refusal_says_why():
    reply = parse_reply(REFUSAL)
    assert not reply.accepted
    assert "is invalid" in reply.text


@exactly
@given(st.binary(max_size=30), st.integers(0, len(REPLY)))
def test_a_reply_is_taken_when_it_is_whole_whatever_is_before_it(before, cut):
    block = b"$@" + before.replace(b"$R", b"").replace(b"$", b"")
    assert parse_reply(block + REPLY[:cut]) is None or cut == len(REPLY)
    reply = parse_reply(block + REPLY)
    assert reply is not None
    assert reply.port == "USB1"


def test_the_order_of_blocks_and_further_fields_do_not_matter():
    data_in_out, dynamics, raw, *_ = wanted_settings("COM2", 5, raw=True)
    assert raw.command == "setSBFOutput, Stream1, COM2, MeasEpoch, msec200"
    positions = wanted_settings("COM2", 1, raw=False)[2]
    line = "  SBFOutput, Stream1, COM2, PosCovGeodetic+EndOfPVT+PVTGeodetic, sec1"
    assert positions.is_met(parse_reply(f"$R: x\r\n{line}\r\nCOM2>".encode()))
    assert not positions.is_met(parse_reply(f"$R: x\r\n{line.replace('COM2,', 'COM1,')}\r\nCOM2>".encode()))
    assert data_in_out.is_met(parse_reply(b"$R: x\r\n  DataInOut, COM2, auto, SBF, (on)\r\nCOM2>"))
    assert dynamics.ask == "getReceiverDynamics"


def test_a_rate_that_the_receiver_does_not_have_is_refused():
    with pytest.raises(ValueError, match="4 Hz, expected one of 1, 2, 5"):
        wanted_settings("USB1", 4, raw=True)
