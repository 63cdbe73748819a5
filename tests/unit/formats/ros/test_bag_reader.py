"""Bags of all kinds are read, damaged ones are one line, and stamps are held against the times of recording."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from camber.formats.errors import FormatError
from camber.formats.ros.bag_reader import StampCheck, open_bag
from camber.geodesy.gps_time import gps_ns_from_unix_ns
from support.ros_bags import NS, BagKind, bag_writer

UNIX_NS = 1_716_000_000 * NS
DAY_NS = 86_400 * NS


def written(path: Path, kind: BagKind, messages: int = 500) -> Path:
    path = path.with_suffix(".bag") if kind == "ros1" else path
    with bag_writer(path, kind) as bag:
        for k in range(messages):
            bag.twist("/twist", UNIX_NS + k * NS // 10, 0.1 * k, 0.0)
            bag.raw("/raw", UNIX_NS + k * NS // 10, bytes(2000))
    return path


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
def test_messages_come_in_order_with_their_times_of_recording(tmp_path: Path, kind: BagKind) -> None:
    with open_bag([written(tmp_path / "bag", kind)]) as bag:
        assert {name: topic.messages for name, topic in bag.topics.items()} == {"/twist": 500, "/raw": 500}
        assert bag.topics["/twist"].kind == "geometry_msgs/msg/TwistStamped"
        messages = list(bag.messages({"/twist"}))
        assert [m.receive_unix_ns for m in messages] == [UNIX_NS + k * NS // 10 for k in range(500)]
        assert bag.decode(messages[30]).twist.linear.x == pytest.approx(3.0)
        assert list(bag.messages(set())) == []


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.98])
def test_a_bag_cut_off_is_one_line(tmp_path: Path, kind: BagKind, share: float) -> None:
    path = written(tmp_path / "bag", kind)
    file = path if kind == "ros1" else next(file for file in path.iterdir() if file.suffix != ".yaml")
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    with pytest.raises(FormatError, match="expected a whole bag") as caught, open_bag([path]) as bag:
        list(bag.messages({"/twist", "/raw"}))
    assert str(caught.value).startswith(f"{path.name}: data")
    assert "\n" not in str(caught.value)


def test_a_bag_without_definitions_is_read_by_the_standard_ones(tmp_path: Path) -> None:
    path = written(tmp_path / "bag", "sqlite3", 3)
    with closing(sqlite3.connect(path / "bag.db3")) as database, database:  # as before Iron
        database.execute("DELETE FROM message_definitions")
    with open_bag([path]) as bag:
        speeds = [bag.decode(message).twist.linear.x for message in bag.messages({"/twist"})]
    assert speeds == pytest.approx([0.0, 0.1, 0.2])


def test_what_is_no_bag_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "drive.pcap").write_bytes(b"x")
    with (
        pytest.raises(FormatError, match=r"expected a folder or a file \.bag, \.mcap, \.db3"),
        open_bag([tmp_path / "drive.pcap"]),
    ):
        pass
    with pytest.raises(FormatError, match=r"expected metadata\.yaml in it"), open_bag([tmp_path]):
        pass
    with pytest.raises(FileNotFoundError), open_bag([tmp_path / "none.mcap"]):
        pass


def test_a_file_of_a_bag_is_read_without_its_folder(tmp_path: Path) -> None:
    path = written(tmp_path / "bag", "mcap", 3)
    with open_bag([path / "bag.mcap"]) as bag:
        assert len(list(bag.messages({"/twist"}))) == 3


def test_a_message_that_is_none_of_its_type_is_one_line(tmp_path: Path) -> None:
    with open_bag([written(tmp_path / "bag", "mcap", 1)]) as bag:
        (message,) = bag.messages({"/twist"})
        cut = type(message)(
            topic=message.topic,
            kind=message.kind,
            receive_unix_ns=0,
            data=message.data[: len(message.data) // 2],
        )
        with pytest.raises(FormatError, match=r"^/twist: message, expected a geometry_msgs/msg/TwistStamped"):
            bag.decode(cut)


def stamped(unix_ns: int) -> Any:
    seconds, nanoseconds = divmod(unix_ns, NS)
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds)))


def test_a_stamp_becomes_gps_time() -> None:
    at_ns = StampCheck("/fix").gps_time_ns(stamped(UNIX_NS + 5), UNIX_NS + NS)
    assert at_ns == gps_ns_from_unix_ns(UNIX_NS + 5)


@pytest.mark.parametrize(
    ("stamp_ns", "receive_ns", "expected"),
    [
        (0, UNIX_NS, r"header\.stamp is '0\.000000000', expected Unix time from 2000 to 2080"),
        (UNIX_NS - 3 * DAY_NS, UNIX_NS, r"within a day of the recording, which is \+3\.0 days later"),
        (UNIX_NS, UNIX_NS - 2 * DAY_NS, r"which is -2\.0 days later"),
    ],
)
def test_a_stamp_that_cannot_be_right_is_one_line(stamp_ns: int, receive_ns: int, expected: str) -> None:
    with pytest.raises(FormatError, match=expected) as caught:
        StampCheck("/fix").gps_time_ns(stamped(stamp_ns), receive_ns)
    assert str(caught.value).startswith("/fix: ")


def test_a_stamp_that_jumps_against_the_recording_is_left_out_and_later_ones_are_not() -> None:
    check = StampCheck("/fix")
    check.gps_time_ns(stamped(UNIX_NS), UNIX_NS)
    with pytest.raises(FormatError, match=r"expected no jump .* but it is \+75\.0 s"):
        check.gps_time_ns(stamped(UNIX_NS + 76 * NS), UNIX_NS + NS)
    assert check.gps_time_ns(stamped(UNIX_NS + 2 * NS), UNIX_NS + 2 * NS)


def test_a_clock_that_is_hours_off_but_steady_is_accepted() -> None:
    check = StampCheck("/fix")
    for k in range(100):
        check.gps_time_ns(stamped(UNIX_NS + k * NS), UNIX_NS + k * NS + 9 * 3600 * NS)
