"""Requests to a caster, and the schedule of positions sent to it."""

from __future__ import annotations

from base64 import b64encode
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.transport.ntrip_client import GgaSchedule, Mountpoint, NtripAccess, request

GGA = "$GPGGA,090000.00,3510.0000,N,13658.0000,E,1,12,0.8,30.0,M,38.0,M,,*5E"
AT = Mountpoint(host="caster.example", port=2101, name="BASE", tls=False)


def lines(asked: bytes) -> list[str]:
    text = asked.decode("ascii")
    assert text.endswith("\r\n\r\n")
    assert text.count("\r\n\r\n") == 1
    return text.splitlines()[:-1]


def test_request_of_revision_2() -> None:
    asked = lines(request(AT, NtripAccess(user="driver", password="g:heim"), GGA))
    assert asked[0] == "GET /BASE HTTP/1.1"
    assert "Host: caster.example:2101" in asked
    assert "Ntrip-Version: Ntrip/2.0" in asked
    assert f"Ntrip-GGA: {GGA}" in asked
    assert f"Authorization: Basic {b64encode(b'driver:g:heim').decode()}" in asked
    assert any(line.startswith("User-Agent: NTRIP ") for line in asked)


def test_request_of_revision_1() -> None:
    asked = lines(request(AT, NtripAccess(version=1), None))
    assert asked[0] == "GET /BASE HTTP/1.0"
    assert [line.partition(":")[0] for line in asked[1:]] == ["User-Agent", "Accept", "Connection"]


def test_an_address_of_ipv6_stands_in_brackets() -> None:
    at = Mountpoint.parse("ntrips://[::1]:443/VRS/3")
    assert at == Mountpoint(host="::1", port=443, name="VRS/3", tls=True)
    assert "Host: [::1]:443" in lines(request(at, NtripAccess(), None))


def test_names_of_any_language_are_sent_as_utf_8() -> None:
    asked = lines(request(AT, NtripAccess(user="fahrer", password="schlüssel"), None))
    assert asked[-1] == "Authorization: Basic " + b64encode("fahrer:schlüssel".encode()).decode()


@given(
    st.lists(st.floats(0.0, 3.0), min_size=1, max_size=80),
    st.floats(1.0, 5.0),
    st.lists(st.integers(0, 79), max_size=3),
)
@settings(derandomize=True, deadline=None)
def test_positions_are_sent_at_the_interval_and_never_more_than_once_a_second(
    steps_s: list[float], interval_s: float, unheard: list[int]
) -> None:
    pace = GgaSchedule(NtripAccess(position=lambda: GGA, position_interval_s=interval_s))
    now_s, sent_s = 0.0, []
    for index, step_s in enumerate(steps_s):
        now_s += step_s
        if pace.take_due(now_s):
            sent_s.append(now_s)
            if index in unheard:
                pace.retry_soon()
        elif sent_s:
            assert now_s - sent_s[-1] < interval_s  # what is due is sent
    gaps_s = [after - before for before, after in pairwise(sent_s)]
    assert all(gap_s >= 1.0 - 1e-9 for gap_s in gaps_s)
    if not unheard:
        assert all(gap_s >= interval_s for gap_s in gaps_s)


@pytest.mark.parametrize(
    "sentence",
    [
        None,
        "",
        "$GPRMC,090000.00,A,3510.0000,N,13658.0000,E,0.0,0.0,110723,,,A*5E",
        GGA + "\r\nGET /",
        GGA[:-3],
        GGA.replace("3510", "35\x0010"),
        "$GPGGA," + "9" * 200 + "*00",
        "$GPGGA,ü*00",
    ],
)
def test_only_gga_sentences_are_sent(sentence: str | None) -> None:
    pace = GgaSchedule(NtripAccess(position=lambda: sentence))
    assert pace.take_due(0.0) is None
    assert "position" in pace.silence_reason


def test_a_sentence_is_sent_as_soon_as_there_is_one() -> None:
    sentences = iter([None, GGA + "\r\n", GGA])
    pace = GgaSchedule(NtripAccess(position=lambda: next(sentences)))
    assert pace.take_due(0.0) is None
    assert pace.take_due(0.1) == GGA
    assert pace.silence_reason == ""
    assert pace.take_due(10.2) == GGA


def test_no_position_is_sent_without_a_provider() -> None:
    assert GgaSchedule(NtripAccess()).silence_reason == ""
