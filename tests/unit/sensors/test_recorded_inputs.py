"""Recordings at the pace of the clock: what was set, what is cut short, what is no recording."""

from dataclasses import replace
from pathlib import Path

import pytest

from camber.formats.drive.timed_file import TimedFile
from camber.formats.lidar_can.candump import CandumpDecoder, CanFrame, candump_text
from camber.formats.lidar_can.pcap import Datagram, PcapDecoder, pcap_frames, pcap_header
from camber.sensors.inputs import Played, gps_ns

S = 1_000_000_000
UNIX_NS = 1_700_000_000 * S
NOW_NS = 1_400_000_000 * S


def played(folder: Path, text: str) -> Played[CanFrame]:
    path = folder / "can.log"
    path.write_text(text)
    result = Played("can", TimedFile(path, CandumpDecoder(path.name)))
    first_ns = result.first_ns()
    result.start(gps_ns(UNIX_NS) if first_ns is None else first_ns, NOW_NS, dated_now=True)
    return result


def frames(*at_s: float) -> str:
    frame = CanFrame(time_ns=0, bus="can0", identifier=1, extended=False, data=b"")
    return candump_text([replace(frame, time_ns=UNIX_NS + round(s * S)) for s in at_s])


def test_what_comes_before_a_step_back_comes_at_its_time_and_the_rest_waits(tmp_path: Path) -> None:
    one = played(tmp_path, frames(*range(3), *range(-3600, 0)))
    assert [len(one.take(NOW_NS + k * S)) for k in range(6)] == [1, 1, 1, 0, 0, 0]
    assert one.step_ns(NOW_NS + 2 * S) == -3602 * S
    first_ns = one.first_ns()
    assert first_ns is not None
    one.start(first_ns, NOW_NS + 10 * S, dated_now=True)
    assert one.step_ns(NOW_NS + 10 * S) == 0
    assert [len(one.take(NOW_NS + k * S)) for k in range(10, 14)] == [1, 1, 1, 1]
    one.close()


def test_a_step_forward_is_one_and_a_gap_is_none(tmp_path: Path) -> None:
    one = played(tmp_path, frames(0, 1, 10, 3600, 3601))
    assert [len(one.take(NOW_NS + k * S)) for k in range(11)] == [1, 1, *[0] * 8, 1]
    assert one.step_ns(NOW_NS + 10 * S) == 3590 * S
    one.close()


def test_what_is_a_little_out_of_order_is_no_step(tmp_path: Path) -> None:
    one = played(tmp_path, frames(0, 1.0, 0.5, 1.5))
    assert [len(one.take(NOW_NS + k * S)) for k in range(3)] == [1, 2, 1]
    assert one.ended
    one.close()


def test_one_call_gives_some_thousands_at_most(tmp_path: Path) -> None:
    one = played(tmp_path, frames(*(k / 1e5 for k in range(10_000))))
    result = [len(one.take(NOW_NS + S)) for _ in range(4)]
    assert sum(result) == 10_000
    assert max(result) < 5000
    one.close()


def test_a_file_of_another_kind_is_given_up_and_not_kept(tmp_path: Path) -> None:
    """As `candump` writes without -l."""
    text = "  can0  1A0   [8]  01 02 03 04 05 06 07 08\n" * 50_000
    one = played(tmp_path, text + frames(0))
    assert one.take(NOW_NS) == []
    assert one.ended
    assert len(one.issues) < 1100
    assert one.issues[1000] == (
        "can_recording",
        "can.log: content, expected a recording of this kind; read no further after 1000 damages together",
    )
    one.close()


def test_damages_between_frames_are_never_too_many(tmp_path: Path) -> None:
    one = played(tmp_path, "".join("damage\n" * 400 + frames(0) for _ in range(5)))
    assert len(one.take(NOW_NS)) + len(one.take(NOW_NS)) == 5
    assert one.counts["damaged"] == 2000
    one.close()


def datagrams() -> list[Datagram]:
    return [Datagram(time_ns=UNIX_NS + k, source="10.0.0.2", port=7502, payload=bytes(100)) for k in range(3)]


def test_frames_that_are_not_whole_are_named_with_the_file_and_how_many(tmp_path: Path) -> None:
    path = tmp_path / "lidar.pcap"
    cut = bytearray(pcap_frames(datagrams()[0], "10.0.0.1", 1))
    cut[12] += 1  # whole, it was a byte longer than what was kept
    path.write_bytes(
        pcap_header()
        + cut
        + b"".join(pcap_frames(each, "10.0.0.1", 2 + k) for k, each in enumerate(datagrams()))
    )
    one = Played("lidar", TimedFile(path, PcapDecoder(path.name)))
    one.start(gps_ns(UNIX_NS), NOW_NS, dated_now=False)
    assert len(one.take(NOW_NS + S)) == 3
    assert one.counts["skipped_truncated"] == 1
    assert (
        "lidar_recording",
        "lidar.pcap: skipped is '1 truncated', expected whole datagrams or data frames",
    ) in (one.issues)
    one.take(NOW_NS + 2 * S)
    assert {code for code, _ in one.issues} <= {"lidar_recording", "lidar_ended"}
    one.close()


@pytest.mark.parametrize(("text", "skipped"), [("(1.0) can0 123#R\n" * 3, "3 remote"), ("", "nothing")])
def test_a_recording_without_anything_is_an_issue(tmp_path: Path, text: str, skipped: str) -> None:
    one = played(tmp_path, text)
    assert one.take(NOW_NS) == []
    expected = f"can.log: skipped is '{skipped}', expected whole datagrams or data frames"
    assert one.issues == [
        ("can_recording", expected),
        ("can_ended", "the recording has been played to its end"),
    ]
    one.close()


def test_remote_frames_among_others_are_only_counted(tmp_path: Path) -> None:
    one = played(tmp_path, "(1700000000.0) can0 123#R\n" + frames(0))
    assert len(one.take(NOW_NS)) == 1
    assert one.issues == [("can_ended", "the recording has been played to its end")]
    assert one.counts["skipped_remote"] == 1
    one.close()
