"""Descriptions of serial ports, with the persistent name of a receiver."""

from __future__ import annotations

from pathlib import Path

from serial.tools.list_ports_common import ListPortInfo

from camber.transport.byte_streams import parse_source
from camber.transport.serial_ports import describe


def port(
    device: Path | str, description: str = "n/a", usb: tuple[int, int, str] | None = None
) -> ListPortInfo:
    decoded = ListPortInfo(str(device), skip_link_detection=True)
    decoded.description = description
    if usb is not None:
        decoded.vid, decoded.pid, decoded.serial_number = usb
    return decoded


def test_absence_of_ports_is_reported(tmp_path: Path) -> None:
    assert describe([], by_id=tmp_path / "missing") == "no serial port is there"


def test_port_is_described_with_its_persistent_name(tmp_path: Path) -> None:
    device = tmp_path / "ttyACM0"
    device.touch()
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    (by_id / "usb-u-blox_GNSS_receiver-if00").symlink_to("../ttyACM0")
    (by_id / "usb-gone").symlink_to("../ttyACM7")
    ports = [
        port("/dev/ttyS0"),
        port(device, "u-blox GNSS receiver", (0x1546, 0x01A9, "ABC")),
        port("/dev/ttyUSB0", "CP2102", (0x10C4, 0xEA60, "")),
    ]
    assert describe(ports, by_id=by_id).splitlines() == [
        "/dev/ttyS0",
        "  --source serial:/dev/ttyS0",
        "/dev/ttyUSB0",
        "  CP2102",
        "  USB 10c4:ea60",
        "  --source serial:/dev/ttyUSB0",
        str(device),
        "  u-blox GNSS receiver",
        "  USB 1546:01a9, serial number ABC",
        f"  --source serial:{by_id}/usb-u-blox_GNSS_receiver-if00",
    ]


def test_described_source_can_be_parsed() -> None:
    for line in describe([port("/dev/ttyS0"), port("/dev/ttyUSB0")], by_id=Path("/missing")).splitlines():
        if "--source" in line:
            assert callable(parse_source(line.split()[1]))
