"""Bytes of a receiver become fixes: every epoch once, in order; garbage costs itself and is named."""

from __future__ import annotations

import json
import math
import os
import pty
import socket
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from random import Random
from typing import Any, cast

import numpy as np
import pytest

from camber.formats.nmea.writer import format_gga, format_gst, format_rmc
from camber.formats.receiver.rtklib_pos import format_pos_header, format_pos_line
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_utc
from camber.gnss.service import GnssService
from camber.gnss.settings import GnssSettings
from camber.live.snapshots import satellites_as_json
from camber.runtime.bus import Bus
from camber.runtime.settings import ConfigError, load
from camber.schemas.gnss import (
    SATELLITE_USES,
    Estimates,
    EstimatesRequest,
    ReceiverBytes,
    ReceiverIntegrity,
    SatellitesInView,
)
from support.gnss_bus import GnssBus
from support.gnss_files import nmea_sentence, recording
from support.sbf_blocks import rf_status
from support.sbf_drive import position_blocks

NS = 1_000_000_000
START_NS = gps_ns_from_utc(CalendarTime(2023, 7, 11, 6, 4, 30))
PATIENCE_S = 20.0


def tenths_of(bus: GnssBus) -> list[int]:
    """Tenths of seconds since the start."""
    return [(fix.time_ns - START_NS) * 10 // NS for fix in bus.fixes]


def make(**settings: Any) -> tuple[GnssService, GnssBus]:
    bus = GnssBus(START_NS + 3600 * NS)
    return GnssService(GnssSettings(**settings), cast(Bus, bus)), bus


def receive(service: GnssService, data: bytes, protocol: Any = "pos") -> None:
    payload = np.frombuffer(data, np.uint8)
    service.handlers()["receiver_bytes"](ReceiverBytes(time_ns=START_NS, protocol=protocol, payload=payload))


def solution(tenths: int, **changed: Any) -> ReceiverSolution:
    base = ReceiverSolution(
        time_ns=START_NS + tenths * NS // 10,
        latitude_rad=math.radians(35.17),
        longitude_rad=math.radians(136.9),
        height_m=40.0 + tenths / 100,
        quality=SolutionQuality.FIX,
        satellites=15,
        covariance_enu_m2=(1e-4, 0.0, 0.0, 1e-4, 0.0, 4e-4),
        age_s=1.0,
        ratio=5.0,
    )
    return replace(base, **changed)


def pos(*tenths: int, header: bool = True, **changed: Any) -> bytes:
    lines = [format_pos_line(solution(n, **changed)) for n in tenths]
    return b"".join([format_pos_header()] * header + lines)


def nmea(*tenths: int, date_sentence: bool = True, **changed: Any) -> bytes:
    sentences = []
    for n in tenths:
        here = solution(n, **changed)
        sentences += [format_rmc(here)] * date_sentence
        sentences += [format_gga(here, geoid_separation_m=37.5), format_gst(here)]
    return b"".join(sentences)


def test_a_pos_stream_becomes_fixes() -> None:
    service, bus = make(datum="JGD2011")
    receive(service, pos(0, 1, 2))
    assert tenths_of(bus) == [0, 1, 2]
    assert bus.issues == []
    fix = bus.fixes[1]
    assert (fix.quality, fix.origin, fix.datum) == ("fixed", "receiver", "JGD2011")
    assert (fix.satellites, fix.ratio) == (15, 5.0)
    assert fix.height_m == pytest.approx(40.01, abs=1e-4)
    assert math.degrees(fix.latitude_rad) == pytest.approx(35.17, abs=1e-9)


def test_an_nmea_stream_becomes_fixes_above_the_ellipsoid() -> None:
    service, bus = make()
    receive(service, nmea(*range(10)), "nmea")
    assert tenths_of(bus) == list(range(10))
    assert bus.issues == []
    assert [fix.height_m for fix in bus.fixes] == pytest.approx([40.0 + n / 100 for n in range(10)], abs=1e-3)
    assert all(fix.covariance_enu_m2 is not None for fix in bus.fixes)


def test_an_nmea_stream_without_a_date_needs_one_in_the_settings() -> None:
    service, bus = make()
    receive(service, nmea(0, 1, 2, date_sentence=False), "nmea")
    assert bus.fixes == []
    assert set(bus.counted()) == {"unreadable_input"}
    service, bus = make(nmea_date=date(2023, 7, 11))
    receive(service, nmea(0, 1, 2, 3, date_sentence=False), "nmea")
    assert tenths_of(bus)[:3] == [0, 1, 2]


@pytest.mark.parametrize("protocol", ["pos", "nmea"])
def test_garbage_costs_itself_only(protocol: str) -> None:
    begin, end = (pos(0, 1), pos(2, 3, header=False)) if protocol == "pos" else (nmea(0, 1), nmea(2, 3))
    random = Random(11)
    print("seed 11")
    for _ in range(20):
        garbage = bytes(random.randrange(256) for _ in range(random.randint(0, 3000)))
        service, bus = make()
        receive(service, begin + b"\n" + garbage + b"\r\n" + end, protocol)
        assert tenths_of(bus) == [0, 1, 2, 3]
        assert set(bus.counted()) <= {"unreadable_input", "damaged_input"}


def test_a_line_that_cannot_be_read_is_named() -> None:
    service, bus = make()
    receive(service, pos(0) + b"2023/07/11 06:04:31.000 far away\n")
    ((code, text),) = bus.issues
    assert code == "unreadable_input"
    assert text.startswith("rover:4: columns is ")


def test_every_epoch_passes_once_and_in_order() -> None:
    service, bus = make()
    receive(service, pos(5, 5, 3, 6))
    assert tenths_of(bus) == [5, 6]
    assert bus.counted() == {"repeated_epoch": 1, "out_of_order_epoch": 1}


@pytest.mark.parametrize(("year", "code"), [(2079, "epoch_from_the_future"), (2089, "unreadable_input")])
def test_a_fix_of_another_century_stops_nothing(year: int, code: str) -> None:
    service, bus = make()
    century = gps_ns_from_utc(CalendarTime(year, 1, 1, 0, 0, 0))
    receive(service, pos(0))
    receive(service, pos(0, header=False, time_ns=century))
    receive(service, pos(1, header=False))
    assert tenths_of(bus) == [0, 1]
    assert bus.counted() == {code: 1}


def test_a_receiver_that_began_in_the_past_is_followed_once_it_knows_the_time() -> None:
    service, bus = make()
    rolled_over = START_NS - 1024 * 7 * 86_400 * NS
    receive(service, pos(0, time_ns=rolled_over) + pos(0, 1, header=False))
    assert tenths_of(bus)[1:] == [0, 1]
    assert bus.issues == []


def test_an_epoch_before_any_plausible_time_is_refused_and_the_next_one_passes() -> None:
    service, bus = make()
    implausible_ns = gps_ns_from_utc(CalendarTime(1999, 8, 22, 0, 0, 0))
    receive(service, pos(0, time_ns=implausible_ns) + pos(0, header=False))
    assert tenths_of(bus) == [0]
    assert bus.counted() == {"implausible_epoch": 1}
    assert bus.issues[0][1].startswith("time_ns: ")


def test_after_a_restart_an_epoch_has_the_same_id() -> None:
    first, before = make()
    receive(first, pos(0, 1))
    second, after = make()
    receive(second, pos(1, 2))
    assert before.fixes[1] == after.fixes[0]


@pytest.mark.parametrize("quality", SolutionQuality)
def test_qualities_come_through_the_pos_format(quality: SolutionQuality) -> None:
    service, bus = make()
    receive(service, pos(0, quality=quality))
    names = {1: "fixed", 2: "float", 3: "sbas", 4: "dgps", 5: "single", 6: "ppp", 7: "estimated"}
    assert bus.fixes[0].quality == names[int(quality)]


@pytest.mark.parametrize(
    ("stream", "protocol"),
    [("rover", "rinex"), ("rover", "rtcm"), ("base", "rtcm"), ("base", "nmea"), ("ephemerides", "rinex")],
)
def test_a_stream_that_is_not_used_is_named_once_and_counted(stream: Any, protocol: Any) -> None:
    service, bus = make()
    payload = np.frombuffer(b"\xb5\x62", np.uint8)
    message = ReceiverBytes(time_ns=START_NS, stream=stream, protocol=protocol, payload=payload)
    for _ in range(3):
        service.handlers()["receiver_bytes"](message)
    ((code, text),) = bus.issues
    assert code == "stream_not_used"
    assert text.startswith(f"{stream}.{protocol}: expected the receiver's positions")
    assert bus.counters == {f"not_used.{stream}.{protocol}": 3}
    receive(service, pos(0))
    assert len(bus.fixes) == 1


def test_a_receivers_solution_has_no_other_candidates() -> None:
    service, _ = make()
    requests = [EstimatesRequest(time_ns=START_NS, fix_id=n) for n in (7, 8)]
    replies: Sequence[Any] = service.answers()["estimates"](requests)
    assert [reply.fix_id for reply in replies] == [7, 8]
    for reply in replies:
        assert isinstance(reply, Estimates)
        assert (reply.status, reply.candidates, reply.trials) == ("unavailable", (), 0)
        assert reply.reason


def test_it_is_healthy_while_epochs_come() -> None:
    service, bus = make()
    assert not service.healthy()
    bus.time_ns = START_NS
    receive(service, pos(0))
    assert service.healthy()
    bus.time_ns = START_NS + 5 * NS
    assert not service.healthy()


def wait(service: GnssService, bus: GnssBus, condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, (tenths_of(bus), bus.issues)
        time.sleep(0.005)
        service.advance(bus.now_ns())


def until(service: GnssService, bus: GnssBus, epochs: list[int]) -> None:
    wait(service, bus, lambda: tenths_of(bus) == epochs)


def test_a_file_is_read_while_it_grows_and_the_bus_is_not(tmp_path: Path) -> None:
    path = tmp_path / "rover.pos"
    path.write_bytes(pos(0, 1))
    service, bus = make(source=f"file:{path}", protocol="pos")
    try:
        assert service.handlers() == {}
        until(service, bus, [0, 1])
        with path.open("ab") as file:
            file.write(pos(2, header=False))
        until(service, bus, [0, 1, 2])
        assert bus.issues == []
    finally:
        service.close()


def test_a_serial_port_is_read() -> None:
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    service, bus = make(source=f"serial:{os.ttyname(theirs)}", protocol="nmea")
    try:
        wait(service, bus, lambda: service._ports[0].port.problem is None)
        os.write(ours, nmea(0, 1, 2, 3))
        until(service, bus, [0, 1, 2, 3])
    finally:
        service.close()
        os.close(ours)
        os.close(theirs)


def test_a_source_that_is_lost_is_an_issue_once_for_each_loss(tmp_path: Path) -> None:
    service, bus = make(source=f"file:{tmp_path / 'nothing.pos'}", protocol="pos")
    try:
        wait(service, bus, lambda: bool(bus.issues))
        for _ in range(100):
            service.advance(bus.now_ns())
        assert 1 <= len(bus.issues) <= service._ports[0].port.failures
        code, text = bus.issues[0]
        assert code == "source_lost"
        assert text.startswith(f"file:{tmp_path / 'nothing.pos'}: ")
    finally:
        service.close()


def test_a_source_that_is_none_is_refused_before_anything_starts() -> None:
    with pytest.raises(
        ConfigError, match=r"^source: 'tcp:host': expected file:PATH, tcp:HOST:PORT or serial:"
    ):
        load(GnssSettings, ["--source", "tcp:host"], prog="camber gnss")


# ---------------------------------------------------------------------------------------------------- the satellites

GSA = b"GNGSA,A,3,05,,,,,,,,,,,,1.7,0.9,1.5,1"
GSV = b"GPGSV,1,1,02,05,45,120,40,06,,,22,1"


def views_of(bus: GnssBus) -> list[SatellitesInView]:
    return [message for message in bus.published if isinstance(message, SatellitesInView)]


def shown(view: SatellitesInView) -> list[list[Any]]:
    """As the sky plot receives them."""
    rows: list[list[Any]] = json.loads(satellites_as_json(view, 0.0))["satellites"]
    return rows


def nmea_with_satellites(*tenths: int, **changed: Any) -> bytes:
    view = b"".join(nmea_sentence(content.decode()) for content in (GSA, GSV))
    return b"".join(nmea(n, **changed) + view for n in tenths)


@pytest.mark.parametrize("protocol", ["nmea", "mixed"])
def test_satellites_of_an_nmea_receiver_are_published_once_a_second(protocol: str) -> None:
    service, bus = make()
    receive(service, nmea_with_satellites(*range(0, 31, 2)), protocol)
    assert tenths_of(bus) == list(range(0, 31, 2))
    views = views_of(bus)
    assert [(view.time_ns - START_NS) // NS for view in views] == [0, 1, 2]
    assert {view.quality for view in views} == {"fixed"}
    assert shown(views[0]) == [
        ["G05", 120.0, 45.0, 40.0, "used"],
        ["G06", None, None, 22.0, "reason_not_reported"],
    ]
    assert bus.issues == []


def test_each_epoch_has_its_satellites_where_that_is_set() -> None:
    service, bus = make(satellites_every_s=0.0)
    # Each epoch twice: repeated satellites are not published again. Those of the last wait for the next epoch.
    receive(service, b"".join(2 * nmea_with_satellites(n) for n in range(5)), "nmea")
    assert [(view.time_ns - START_NS) * 10 // NS for view in views_of(bus)] == [0, 1, 2, 3]


def test_satellites_from_the_future_are_not_published() -> None:
    service, bus = make()
    receive(service, nmea_with_satellites(40_000, 40_010, 40_020), "nmea")
    assert views_of(bus) == []
    assert set(bus.counted()) == {"epoch_from_the_future"}


def test_a_missing_sentence_of_gsv_is_reported_as_damage() -> None:
    service, bus = make()
    first = nmea_sentence("GPGSV,2,1,05,05,45,120,40,06,20,010,22,1")
    receive(service, b"".join(nmea(n) + first for n in (0, 10, 20)), "mixed")
    assert bus.counters["rover.incomplete"] == 2
    assert [len(view.satellite) for view in views_of(bus)] == [2, 2]


def test_without_a_position_no_satellite_is_used() -> None:
    service, bus = make(nmea_date=date(2023, 7, 11))
    empty = b"".join(nmea_sentence(f"GNGGA,0604{second}.00,,,,,0,00,99.99,,,,,,") for second in (30, 31))
    view = b"".join(nmea_sentence(content.decode()) for content in (GSA, GSV))
    receive(service, empty[: len(empty) // 2] + view + empty[len(empty) // 2 :], "nmea")
    (message,) = views_of(bus)
    assert message.quality == "none"
    assert [row[4] for row in shown(message)] == ["no_position", "no_position"]


def test_a_receiver_that_lists_no_satellite_has_none() -> None:
    service, bus = make()
    receive(service, nmea(0) + nmea_sentence("GPGSV,1,1,00,1") + nmea(1), "nmea")
    (view,) = views_of(bus)
    assert shown(view) == []


@pytest.mark.parametrize("protocol", ["sbf", "mixed"])
def test_positions_and_warnings_of_a_septentrio_receiver_are_published(protocol: str) -> None:
    service, bus = make()
    # A clock a year off does not matter: the blocks contain their date.
    bus.time_ns = START_NS + 365 * 86_400 * NS
    data = b"".join(position_blocks(solution(n)) for n in range(3))
    data += rf_status(solution(2).time_ns, [(1_575_420_000, 100, 8)], flags=0b10)
    receive(service, data, protocol)
    assert [fix.time_ns for fix in bus.fixes] == [solution(n).time_ns for n in range(3)]
    assert bus.qualities() == ["fixed"] * 3
    statements = [message for message in bus.published if isinstance(message, ReceiverIntegrity)]
    assert (statements[-1].raim, statements[-1].jamming, statements[-1].spoofing) == (
        "passed",
        "critical",
        "affirmed",
    )
    assert bus.issues == []


@pytest.mark.parametrize("protocol", ["ubx", "mixed"])
def test_satellites_of_a_recorded_ubx_receiver_are_published(protocol: str) -> None:
    data = recording("receiver-logs/ubx-pygpsdata-MIXED.log").read_bytes()
    service, bus = make(source="bus")
    bus.time_ns = gps_ns_from_utc(CalendarTime(2020, 10, 23, 11, 40, 0))
    receive(service, data, protocol)
    views = views_of(bus)
    # One a second, although the times of its epochs differ from whole seconds; eleven of the 39 epochs have none.
    assert len(views) == 28
    assert {view.quality for view in views} == {"single"}
    fixes = {fix.time_ns: fix for fix in bus.fixes}
    used = SATELLITE_USES.index("used")
    assert all((view.use == used).sum() == fixes[view.time_ns].satellites for view in views)
    rows = {row[0]: row for row in shown(views[0])}
    assert rows["G03"] == ["G03", 89.0, 41.0, 24.0, "used"]
    assert rows["S20"] == ["S20", 196.0, 28.0, None, "no_pseudorange"]


def test_an_engine_leaves_out_the_satellites_of_the_receiver() -> None:
    data = recording("receiver-logs/ubx-pygpsdata-MIXED.log").read_bytes()
    service, bus = make(positions="engine")
    bus.time_ns = gps_ns_from_utc(CalendarTime(2020, 10, 23, 11, 40, 0))
    receive(service, data, "mixed")
    service.advance(bus.time_ns)
    assert views_of(bus) == []


# --- corrections for a receiver that solves itself -------------------------------------------------------------------


@pytest.fixture
def receiver() -> Iterator[socket.socket]:
    """A receiver's port on the network."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(PATIENCE_S)
        yield listening


def test_the_bases_bytes_go_to_the_receiver_as_they_are(receiver: socket.socket) -> None:
    port = receiver.getsockname()[1]
    service, bus = make(source=f"tcp:127.0.0.1:{port}", base_source="bus", forward_corrections=True)
    frames = bytes(range(256)) * 3
    message = ReceiverBytes(
        time_ns=START_NS, protocol="rtcm", stream="base", payload=np.frombuffer(frames, np.uint8)
    )
    with receiver.accept()[0] as peer:
        peer.settimeout(PATIENCE_S)
        deadline_s = time.monotonic() + PATIENCE_S
        while not bus.counters["corrections.sent_bytes"] and time.monotonic() < deadline_s:
            service.handlers()["receiver_bytes"](message)  # until the connection is open on this side too
            time.sleep(0.01)
        assert peer.recv(len(frames)) == frames
        peer.sendall(pos(0))
    assert "stream_not_used" not in bus.named()
    service.close()


def test_corrections_that_a_receiver_does_not_take_are_an_issue(receiver: socket.socket) -> None:
    port = receiver.getsockname()[1]
    receiver.close()
    service, bus = make(source=f"tcp:127.0.0.1:{port}", base_source="bus", forward_corrections=True)
    payload = np.zeros(10, np.uint8)
    service.handlers()["receiver_bytes"](
        ReceiverBytes(time_ns=START_NS, protocol="rtcm", stream="base", payload=payload)
    )
    assert bus.named()["corrections_not_sent"].endswith("it has not taken all of 10 bytes")
    service.close()


@pytest.mark.parametrize(
    "wrong",
    [
        {"positions": "engine", "source": "tcp:h:1", "base_source": "bus"},
        {"source": "bus", "base_source": "bus"},
        {"source": "tcp:h:1"},
    ],
)
def test_corrections_need_a_receiver_that_solves_itself_at_a_port(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="forward_corrections: expected"):
        GnssSettings(forward_corrections=True, **wrong)
