"""Settings of u-blox receivers: the same keys, values and frames as pyubx2 has, and nothing of a damaged answer."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2 import POLL, SET, UBXMessage, UBXReader
from pyubx2.ubxtypes_configdb import UBX_CONFIG_DATABASE

from camber.formats.errors import FormatError
from camber.formats.ubx.configuration import (
    RATE_MEAS_MS,
    UBX_PORTS,
    is_acknowledged,
    key_name,
    read_values,
    value_request,
    value_setting,
    wanted_values,
)
from camber.formats.ubx.writer import ubx_frame

NAMES = {key: name for name, (key, _) in UBX_CONFIG_DATABASE.items()}
exactly = settings(derandomize=True, deadline=None)


@pytest.mark.parametrize("raw", [True, False])
@pytest.mark.parametrize("port", UBX_PORTS)
def test_each_key_is_the_one_of_its_message_and_port(port, raw):
    for key in wanted_values(port, 5, raw=raw):
        oracle, name = NAMES[key], key_name(key)
        if oracle.startswith("CFG_MSGOUT_UBX_"):
            message, _, at = oracle.removeprefix("CFG_MSGOUT_UBX_").rpartition("_")
            assert name == f"{message.replace('_', '-', 1)} on {at}, each n-th epoch"
            assert at == port.upper()
        elif "PROT_" in oracle:
            assert oracle.startswith(f"CFG_{port.upper()}")
            assert oracle.rpartition("_")[2].startswith(name.split()[0])
        else:
            assert key in (RATE_MEAS_MS, 0x30210002, 0x20110021)


def test_raw_observations_or_positions_are_sent_and_reports_once_a_second():
    raw, positions = (
        {NAMES[key]: value for key, value in wanted_values("usb", 5, raw=raw).items()}
        for raw in (True, False)
    )
    assert raw["CFG_RATE_MEAS"] == 200
    assert (raw["CFG_MSGOUT_UBX_RXM_RAWX_USB"], positions["CFG_MSGOUT_UBX_RXM_RAWX_USB"]) == (1, 0)
    assert (raw["CFG_MSGOUT_UBX_NAV_PVT_USB"], positions["CFG_MSGOUT_UBX_NAV_PVT_USB"]) == (0, 1)
    assert raw["CFG_MSGOUT_UBX_MON_RF_USB"] == positions["CFG_MSGOUT_UBX_MON_RF_USB"] == 5
    assert raw["CFG_USBINPROT_RTCM3X"] == 1


def test_a_request_is_pyubx2s_poll():
    expected = UBXMessage.config_poll(0, 0, ["CFG_RATE_MEAS"]).serialize()
    assert value_request(RATE_MEAS_MS) == expected
    assert UBXReader.parse(value_request(RATE_MEAS_MS), msgmode=POLL).identity == "CFG-VALGET"


@pytest.mark.parametrize("port", UBX_PORTS)
def test_a_setting_is_pyubx2s(port):
    values = wanted_values(port, 10, raw=True)
    expected = UBXMessage.config_set(7, 0, [(NAMES[key], value) for key, value in values.items()]).serialize()
    assert value_setting(values, 7) == expected
    assert UBXReader.parse(expected, msgmode=SET).identity == "CFG-VALSET"


def answer(values, version=1):
    body = b"".join(
        struct.pack("<I", key) + value.to_bytes({1: 1, 2: 1, 3: 2, 4: 4, 5: 8}[key >> 28], "little")
        for key, value in values.items()
    )
    return ubx_frame(0x06, 0x8B, struct.pack("<BBH", version, 0, 0) + body)


def test_an_answer_has_the_values_that_pyubx2_reads_in_it():
    values = wanted_values("uart1", 4, raw=False)
    frame = answer(values)
    parsed = UBXReader.parse(frame)
    assert read_values(frame) == values
    assert {name: getattr(parsed, name) for name in map(NAMES.get, values)} == {
        NAMES[key]: value for key, value in values.items()
    }


@pytest.mark.parametrize(("message_id", "expected"), [(1, True), (0, False)])
def test_an_acknowledgement_is_about_its_request_alone(message_id, expected):
    of_setting = ubx_frame(0x05, message_id, b"\x06\x8a")
    assert is_acknowledged(of_setting, setting=True) is expected
    assert is_acknowledged(of_setting, setting=False) is None
    assert is_acknowledged(answer({}), setting=True) is None
    assert read_values(of_setting) is None


@exactly
@given(st.binary(max_size=40))
def test_a_damaged_answer_is_a_format_error_or_numbers(payload):
    try:
        values = read_values(ubx_frame(0x06, 0x8B, payload))
    except FormatError:
        return
    assert values is not None
    assert all(value >= 0 for value in values.values())


def test_values_that_do_not_fit_and_too_many_keys_are_refused():
    with pytest.raises(
        ValueError, match=r"70000 for measurement period \[ms\], expected a number of 2 bytes"
    ):
        value_setting({RATE_MEAS_MS: 70_000}, 1)
    with pytest.raises(ValueError, match="0 keys, expected 1 to 64"):
        value_setting({}, 1)
