"""candump lines, DBC files, frames of Linux sockets."""

import struct
from random import Random

import pytest

from camber.formats.errors import FormatError
from camber.formats.lidar_can.candump import CandumpDecoder, CanFrame, candump_text
from camber.formats.lidar_can.dbc import DbcSignal, read_dbc
from camber.transport.packet_ports import frame_from_socket

FRAMES = [
    CanFrame(
        time_ns=1_700_000_000_000_000_000 + time_us * 1000,
        bus=bus,
        identifier=i,
        extended=extended,
        data=data,
    )
    for time_us, bus, i, extended, data in (
        (123_456, "can0", 0x1A0, False, b"\x01\x02\x03"),
        (123_457, "can0", 0x18FEF200, True, bytes(8)),
        (1_000_000, "vcan1", 0x7FF, False, b""),
        (1_000_001, "can0", 0x10, False, bytes(range(64))),
    )
]
DBC = """\
VERSION "1"
BO_ 416 Wheels: 8 Gateway
 SG_ Speed : 7|16@0- (0.01,0) [-300|300] "km/h" Vector__XXX
 SG_ Fine m1 : 16|12@1+ (0.5,-10) [0|0] "" A,B
 SG_ Real : 32|32@1- (1,0) [0|0] "m" A
BO_ 2566844928 Far: 8 Gateway
 SG_ One : 0|1@1+ (1,0) [0|1] "" A
BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX
 SG_ Lost : 0|8@1+ (1,0) [0|0] "" Vector__XXX
CM_ BO_ 416 "a comment;
BO_ 416 Twice: 8 Nobody
 with \\"quotes\\"";
SIG_VALTYPE_ 416 Real : 1;
"""


def decoded(text: str) -> list:
    decoder = CandumpDecoder("x.log")
    return decoder.feed(text.encode()) + decoder.finish()


def test_written_frames_are_read_back() -> None:
    assert decoded(candump_text(FRAMES)) == FRAMES


def test_lines_of_candump_are_decoded() -> None:
    lines = "(1436509052.249713) vcan0 044#2A366C2BBA\n(1436509053.850870) vcan0 1F334455#1122334455667788\n"
    assert [(f.identifier, f.extended, f.data.hex(), f.time_ns) for f in decoded(lines)] == [
        (0x44, False, "2a366c2bba", 1436509052249713000),
        (0x1F334455, True, "1122334455667788", 1436509053850870000),
    ]


def test_remote_and_error_frames_are_counted_and_only_damaged_lines_are_lost() -> None:
    decoder = CandumpDecoder("x.log")
    text = "(1.0) can0 123#R\n(1.0) can0 20000004#0000000000000000\nnonsense\n(1.0) can0 900#00\n(1.0) can0 001#00\n"
    results = decoder.feed(text.encode())
    assert decoder.skipped == {"remote": 1, "error": 1}
    assert [type(each) for each in results] == [FormatError, FormatError, CanFrame]
    assert str(results[0]).startswith("x.log:3: line is 'nonsense', expected (seconds) bus identifier#bytes")


def test_messages_and_signals_of_a_dbc_file() -> None:
    messages = read_dbc(DBC, "x.dbc")
    assert sorted(messages) == ["Far", "Wheels"]
    far, wheels = messages["Far"], messages["Wheels"]
    assert (far.identifier, far.extended) == (0x18FEF200, True)
    assert (wheels.identifier, wheels.extended) == (416, False)
    speed, fine = wheels.signals["Speed"], wheels.signals["Fine"]
    assert (speed.intel, speed.signed, speed.factor, speed.unit) == (False, True, 0.01, "km/h")
    assert (fine.intel, fine.signed, fine.offset, fine.multiplexed) == (True, False, -10.0, True)
    assert [name for name, signal in wheels.signals.items() if signal.real] == ["Real"]


@pytest.mark.parametrize("words", ["Real : 1;", "Real: 2 ;", "Real 1;", "Real  2;"])
def test_a_floating_point_signal_is_one_with_a_colon_or_without(words: str) -> None:
    signals = read_dbc(DBC.replace("Real : 1;", words), "x.dbc")["Wheels"].signals
    assert [name for name, signal in signals.items() if signal.real] == ["Real"]


def test_tabs_may_separate_fields() -> None:
    assert read_dbc(DBC.replace("SG_ ", "SG_\t").replace("\nBO_ ", "\nBO_\t"), "x.dbc") == read_dbc(
        DBC, "x.dbc"
    )


def signal_at(start: int, bits: int, *, intel: bool, signed: bool = False) -> DbcSignal:
    scaling = {"factor": 1.0, "offset": 0.0, "least": 0.0, "most": 0.0, "unit": ""}
    return DbcSignal(message="M", name="s", start_bit=start, bits=bits, intel=intel, signed=signed, **scaling)  # type: ignore[arg-type]


def test_bit_positions_in_both_byte_orders() -> None:
    """Worked by hand: 0x1234 as Motorola's from bit 7 of byte 0, as Intel's from bit 4."""
    assert signal_at(7, 16, intel=False).raw(bytes.fromhex("1234")) == 0x1234
    intel = signal_at(4, 16, intel=True)
    assert intel.raw(bytes.fromhex("402301")) == 0x1234
    assert intel.raw(bytes.fromhex("4023")) is None
    twelve = signal_at(3, 12, intel=False, signed=True)
    assert twelve.raw(bytes.fromhex("0fff")) == -1
    assert twelve.raw(bytes.fromhex("f7ff")) == 2047


def test_a_placed_signal_is_read_back_and_changes_no_other_bit() -> None:
    """Reference: a walk bit by bit."""
    random = Random(3)
    for _ in range(2000):
        intel, signed = random.random() < 0.5, random.random() < 0.5
        start, bits = random.randrange(64), random.randrange(1, 65)
        signal = signal_at(start, bits, intel=intel, signed=signed)
        if signal.last_byte >= 8:
            continue
        places = [start]
        while len(places) < bits:
            last = places[-1]
            places.append(last + 1 if intel else last - 1 if last % 8 else last + 15)
        before = random.randbytes(8)
        raw = random.randrange(1 << bits) - ((1 << (bits - 1)) if signed else 0)
        after = signal.placed(raw, before)
        values = [after[place // 8] >> place % 8 & 1 for place in places]
        number = sum(bit << k for k, bit in enumerate(values if intel else values[::-1]))
        assert number == raw % (1 << bits)
        assert signal.raw(after) == raw
        untouched = [b for b in range(64) if b not in places]
        assert all(before[b // 8] >> b % 8 & 1 == after[b // 8] >> b % 8 & 1 for b in untouched)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("BO_ 416 Wheels 8 Gateway", "x.dbc:1: message is 'BO_ 416 Wheels 8 Gateway', expected BO_ identifier name"),
        ("BO_ 4096 Wheels: 8 Gateway", "x.dbc:1: identifier is '4096', expected 11 or 29 bits"),
        ('BO_ 1 A: 2 X\n SG_ s : 8|9@1+ (1,0) [0|0] "" X', "x.dbc:2: signal s is '8|9', expected 1 to 64 bits within"),
        ('BO_ 1 A: 2 X\n SG_ s : 8|8@1+ (0,0) [0|0] "" X', "x.dbc:2: signal s, expected a factor, finite and not zero"),
        ("BO_ 1 A: 2 X\nBO_ 1 B: 2 X", "x.dbc:2: message is 'B', expected each once"),
        ("nothing", "x.dbc: content, expected messages"),
    ],
)  # fmt: skip
def test_an_invalid_dbc_file_is_one_clear_error(line: str, message: str) -> None:
    with pytest.raises(FormatError) as error:
        read_dbc(line, "x.dbc")
    assert str(error.value).startswith(message)


def socket_bytes(frame: CanFrame) -> bytes:
    """A frame as Linux' SocketCAN has it: 16 bytes, or 72 where it is longer than eight."""
    flags = frame.identifier | (0x8000_0000 if frame.extended else 0)
    return struct.pack(f"=IB3x{8 if len(frame.data) <= 8 else 64}s", flags, len(frame.data), frame.data)


@pytest.mark.parametrize("frame", FRAMES, ids=lambda frame: candump_text([frame]))
def test_a_frame_of_a_socket_equals_that_of_a_log(frame: CanFrame) -> None:
    assert frame_from_socket(socket_bytes(frame), frame.time_ns, frame.bus) == frame


def test_remote_and_error_frames_of_a_socket_are_ignored() -> None:
    whole = bytearray(socket_bytes(FRAMES[0]))
    for flag in (0x40, 0x20):
        other = bytes(whole[:3]) + bytes([whole[3] | flag]) + bytes(whole[4:])
        assert frame_from_socket(other, 0, "can0") is None
    assert frame_from_socket(bytes(15), 0, "can0") is None
