"""gnss with the engine: right fixes from all mixes of formats; bad input is counted, named, and makes no wrong fix."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from dataclasses import replace
from random import Random
from typing import Any, cast

import numpy as np
import pytest

from camber.formats.observations import ObservationEpoch, satellite_name, signal_number
from camber.formats.receiver.frame_buffer import FrameBuffer
from camber.formats.rtcm.writer import format_reference_station
from camber.formats.ubx.writer import format_raw_measurements, ubx_frame
from camber.gnss.observations.receiver_streams import StreamReader
from camber.gnss.service import GnssService
from camber.gnss.settings import GnssSettings
from camber.runtime.bus import Bus
from camber.schemas.gnss import (
    SATELLITE_USES,
    EstimatesRequest,
    Fix,
    Observations,
    ReceiverBytes,
    ReceiverIntegrity,
    SatellitesInView,
    SatelliteVelocity,
)
from camber.schemas.motion import Motion
from support.engine_drives import clock_ahead, some_rows
from support.gnss_bus import GnssBus
from support.raw_drive import RawDrive

NS = 1_000_000_000
RIGHT_M = 0.05
EPOCHS = 12
NONE = np.zeros(0, np.int64)
Sent = tuple[str, str, bytes]
Tick = Callable[[int], Iterable[Sent]]
Bytes = Callable[[int], bytes]


def received(time_ns: int, data: bytes, **of: Any) -> ReceiverBytes:
    return ReceiverBytes(time_ns=time_ns, payload=np.frombuffer(data, np.uint8), **of)


class Run:
    """The service over the first epochs of the drive; `tick` is the content of each, or else `streams`."""

    def __init__(
        self,
        drive: RawDrive,
        tick: Tick | None = None,
        *,
        rover: Bytes | None = None,
        base: Bytes | None = None,
        epochs: int = EPOCHS,
        delay_ns: int = NS // 20,
        **settings: Any,
    ) -> None:
        tick = tick or streams(drive, rover, base)
        self.bus = GnssBus()
        self.bus.time_ns = drive.times_ns[0] - NS
        self.service = GnssService(GnssSettings(positions="engine", **settings), cast(Bus, self.bus))
        self.drive = drive
        for k in range(epochs):
            self.epoch(drive.times_ns[k] + delay_ns, tick(k))

    def epoch(self, now_ns: int, sent: Iterable[Sent]) -> None:
        handlers = self.service.handlers()
        self.bus.time_ns = now_ns
        for stream, protocol, data in sent:
            handlers["receiver_bytes"](received(now_ns, data, stream=stream, protocol=protocol))
        handlers["motion"](Motion(time_ns=now_ns, wheel_speed_m_s=3.0, yaw_rate_rad_s=0.0))
        self.service.advance(now_ns)

    def fixed(self) -> list[Fix]:
        """All that calls itself fixed; every one of them must be right."""
        fixed = [fix for fix in self.bus.fixes if fix.quality == "fixed"]
        for fix in fixed:
            nearest = min(self.drive.times_ns, key=lambda time_ns: abs(time_ns - fix.time_ns))
            assert abs(nearest - fix.time_ns) < 2_000_000
            assert self.drive.error_m(fix.model_copy(update={"time_ns": nearest})) < RIGHT_M
        return fixed


def streams(drive: RawDrive, rover: Bytes | None = None, base: Bytes | None = None) -> Tick:
    """UBX of the rover, RTCM of the base, which has the ephemerides; or what else they send."""
    rover, base = rover or drive.ubx_parts.__getitem__, base or drive.rtcm_parts.__getitem__
    return lambda k: [("rover", "ubx", rover(k)), ("base", "rtcm", base(k))]


def files(drive: RawDrive) -> Tick:
    def tick(k: int) -> Iterable[Sent]:
        if k == 0:
            for start in range(0, len(drive.navigation), 64_000):
                yield "ephemerides", "rinex", drive.navigation[start : start + 64_000]
        yield "base", "rinex", (drive.base_header if k == 0 else b"") + drive.base_rinex_parts[k]
        yield "rover", "rinex", (drive.rover_header if k == 0 else b"") + drive.rover_rinex_parts[k]

    return tick


def measured(drive: RawDrive, k: int) -> ObservationEpoch:
    (published,) = StreamReader("rover", "ubx", "here", drive.times_ns[0]).feed(drive.ubx_parts[k])[:1]
    assert isinstance(published[1], ObservationEpoch)
    return published[1]


def measuring(drive: RawDrive, change: Callable[[int, ObservationEpoch], ObservationEpoch]) -> Bytes:
    return lambda k: format_raw_measurements(change(k, measured(drive, k)))


@pytest.mark.parametrize("kind", [streams, files])
def test_raw_observations_become_right_fixes(kind: Callable[[RawDrive], Tick], raw_drive: RawDrive) -> None:
    run = Run(raw_drive, kind(raw_drive))
    assert [fix.time_ns for fix in run.bus.fixes] == raw_drive.times_ns[:EPOCHS]
    assert len(run.fixed()) == EPOCHS
    assert run.bus.counters["epochs.fixed"] == EPOCHS
    assert run.bus.issues == []
    assert {fix.origin for fix in run.bus.fixes} == {"engine"}
    assert run.bus.fixes[-1].age_of_corrections_s == 0.0
    assert run.bus.fixes[-1].ambiguity_continuity == "continuous"
    assert run.service.healthy()


def test_sbf_gives_the_fixes_of_ubx(raw_drive: RawDrive) -> None:
    base = raw_drive.rtcm_parts
    run = Run(raw_drive, lambda k: [("rover", "sbf", raw_drive.sbf_parts[k]), ("base", "rtcm", base[k])])
    assert len(run.fixed()) == EPOCHS
    assert run.bus.issues == []
    for ours, other in zip(run.bus.fixes, Run(raw_drive).bus.fixes, strict=True):
        assert ours.time_ns == other.time_ns
        assert abs(ours.height_m - other.height_m) < 0.003
    mixed = [rtcm + sbf for rtcm, sbf in zip(base, raw_drive.sbf_parts, strict=True)]
    assert len(Run(raw_drive, lambda k: [("rover", "mixed", mixed[k])]).fixed()) == EPOCHS


def test_one_port_with_ubx_rtcm_and_nmea_gives_the_same(raw_drive: RawDrive) -> None:
    nmea = b"$GPGGA,013000.00,3510.0000,N,13652.0000,E,4,12,0.8,30.0,M,38.0,M,1.0,0001*5E\r\n"
    mixed = [rtcm + nmea + ubx for rtcm, ubx in zip(raw_drive.rtcm_parts, raw_drive.ubx_parts, strict=True)]
    assert len(Run(raw_drive, lambda k: [("rover", "mixed", mixed[k])]).fixed()) == EPOCHS


def test_the_base_is_used_before_the_rover_in_any_order_of_arrival(raw_drive: RawDrive) -> None:
    first = Run(raw_drive, lambda k: reversed(list(streams(raw_drive)(k))))
    second = Run(raw_drive)
    assert first.bus.fixes == second.bus.fixes
    assert [fix.age_of_corrections_s for fix in first.bus.fixes] == [0.0] * EPOCHS


def test_velocities_come_with_a_heading_where_the_wheels_turn_and_observations_where_asked_for(
    raw_drive: RawDrive,
) -> None:
    quiet = Run(raw_drive, epochs=4)
    assert not [message for message in quiet.bus.published if isinstance(message, Observations)]
    run = Run(raw_drive, epochs=4, publish_observations=True)
    observations = [message for message in run.bus.published if isinstance(message, Observations)]
    assert [message.time_ns for message in observations] == raw_drive.times_ns[:4]
    assert len(observations[0].satellite) == measured(raw_drive, 0).satellite.size
    velocities = [message for message in run.bus.published if isinstance(message, SatelliteVelocity)]
    assert [message.time_ns for message in velocities] == raw_drive.times_ns[:4]
    assert np.abs([message.velocity_enu_m_s for message in velocities]).max() < 1.0  # it begins from rest


def test_the_judge_gets_other_estimates_of_an_epoch(raw_drive: RawDrive) -> None:
    run = Run(raw_drive)
    ids = [fix.fix_id for fix in run.bus.fixes]
    requests = [EstimatesRequest(time_ns=run.bus.time_ns, fix_id=n) for n in (ids[-1], ids[-1] + 1)]
    known, unknown = run.service.answers()["estimates"](requests)
    assert known is not None
    assert unknown is not None
    assert (known.status, unknown.status) == ("available", "forgotten")  # type: ignore[attr-defined]
    assert len(known.candidates) > 5  # type: ignore[attr-defined]


def test_a_fix_says_whether_its_subsets_agree_where_that_is_asked_for(raw_drive: RawDrive) -> None:
    asked = Run(raw_drive, epochs=3).fixed()
    assert {fix.subset_agreement for fix in asked} == {"agree"}
    spared = Run(raw_drive, epochs=3, engine={"subset_agreement": False}).fixed()
    assert {fix.subset_agreement for fix in spared} == {"unknown"}
    assert [(f.fix_id, f.height_m) for f in spared] == [(f.fix_id, f.height_m) for f in asked]


def test_a_base_position_that_is_configured_counts_whatever_the_stream_says(raw_drive: RawDrive) -> None:
    true = station(raw_drive)
    lies = format_reference_station((true[0] + 500.0, true[1], true[2]), station_id=1)

    def lying(k: int) -> bytes:
        return lies + without(raw_drive, k, {1005}) + lies

    assert len(Run(raw_drive, base=lying, base_ecef_m=true).fixed()) == EPOCHS
    assert Run(raw_drive, base=lying).fixed() == []


def station(drive: RawDrive) -> tuple[float, float, float]:
    published = StreamReader("base", "rtcm", "here", drive.times_ns[0]).feed(drive.rtcm_parts[0])
    (place,) = [what.position_ecef_m for _, what in published if hasattr(what, "position_ecef_m")]
    return cast(tuple[float, float, float], place)


def without(drive: RawDrive, k: int, numbers: set[int]) -> bytes:
    """The base's bytes of one epoch without some messages."""
    return b"".join(
        frame.data
        for frame in FrameBuffer("rtcm").feed(drive.rtcm_parts[k])
        if frame.data[3] << 4 | frame.data[4] >> 4 not in numbers
    )


def damaged(data: bytes, random: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(random.randrange(3)):
        place = random.randrange(len(changed))
        changed[place : place + random.randrange(1, 30)] = random.randbytes(random.randrange(30))
    return bytes(changed[: random.randrange(len(changed))] if random.random() < 0.1 else changed)


@pytest.mark.parametrize("kind", [streams, files])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_damaged_and_truncated_streams_cost_epochs_and_make_no_fix_wrong(
    kind: Callable[[RawDrive], Tick], seed: int, raw_drive: RawDrive
) -> None:
    random = Random(seed)
    sound = kind(raw_drive)

    def tick(k: int) -> Iterable[Sent]:
        for stream, protocol, data in sound(k):
            yield stream, protocol, data if k == 0 or stream == "ephemerides" else damaged(data, random)

    run = Run(raw_drive, tick, epochs=40)
    assert 5 < len(run.fixed()) <= 40
    assert run.bus.named().keys() & {"damaged_input", "unreadable_input"}


def test_wrong_checksums_are_counted_and_leave_the_base_silent(raw_drive: RawDrive) -> None:
    def wrong(k: int) -> bytes:
        return b"".join(bytes([*frame[:-1], frame[-1] ^ 1]) for frame in raw_drive.frames(k))

    run = Run(raw_drive, base=wrong)
    assert run.fixed() == []
    sent = sum(len(raw_drive.frames(k)) for k in range(EPOCHS))
    assert run.bus.counters["base.failed_checks"] >= sent
    assert run.bus.named()["damaged_input"].startswith("base: bytes_skipped ")
    assert f"failed_checks {run.bus.counters['base.failed_checks']}" in run.bus.named()["damaged_input"]
    assert "base_silent" in run.bus.named()


def test_several_protocols_on_a_port_configured_for_one_are_named(raw_drive: RawDrive) -> None:
    run = Run(raw_drive, lambda k: [("rover", "ubx", raw_drive.rtcm_parts[k] + raw_drive.ubx_parts[k])])
    assert run.fixed() == []
    assert run.bus.named()["damaged_input"].endswith("expected ubx alone (several on one port: mixed)")


def test_positions_on_a_stream_are_not_used_and_that_is_reported(raw_drive: RawDrive) -> None:
    run = Run(raw_drive, lambda k: [("rover", "nmea", b"$GPGGA\r\n"), *streams(raw_drive)(k)])
    assert len(run.fixed()) == EPOCHS
    assert run.bus.issues == [
        (
            "stream_not_used",
            "rover.nmea: expected observations or ephemerides: ubx, sbf, rtcm, mixed or rinex",
        )
    ]
    assert run.bus.counters["not_used.rover.nmea"] == EPOCHS


def test_a_receiver_whose_week_rolled_over_is_dated_right(raw_drive: RawDrive) -> None:
    def rolled(k: int) -> bytes:
        raw = bytearray(format_raw_measurements(measured(raw_drive, k))[6:-2])
        (week,) = struct.unpack_from("<H", raw, 8)
        struct.pack_into("<H", raw, 8, week - 1024)
        return ubx_frame(0x02, 0x15, bytes(raw))

    run = Run(raw_drive, rover=rolled)
    assert [fix.time_ns for fix in run.fixed()] == raw_drive.times_ns[:EPOCHS]


def test_a_clock_that_lacks_the_leap_seconds_makes_all_epochs_come_from_the_future(
    raw_drive: RawDrive,
) -> None:
    run = Run(raw_drive, delay_ns=-18 * NS)
    assert run.bus.fixes == []
    assert {code for code, _ in run.bus.issues} == {"epoch_from_the_future"}
    assert not run.service.healthy()


def test_a_clock_that_was_set_by_years_has_the_streams_read_anew(raw_drive: RawDrive) -> None:
    run = Run(raw_drive, epochs=3, delay_ns=-(10 * 365 + 3) * 86_400 * NS)
    assert run.bus.fixes == []
    for k in range(3, 3 + EPOCHS):
        first = [("base", "rtcm", raw_drive.rtcm_parts[0])] if k == 3 else []
        run.epoch(raw_drive.times_ns[k], [*first, *streams(raw_drive)(k)])
    assert len(run.fixed()) >= EPOCHS - 3


def test_without_ephemerides_the_satellites_are_named(raw_drive: RawDrive) -> None:
    run = Run(raw_drive, base=lambda k: without(raw_drive, k, {1019, 1042, 1044, 1045, 1046}))
    assert run.bus.fixes == []
    lacking = run.bus.named()["ephemeris_missing"].removeprefix(f"{EPOCHS} epochs; ")
    satellites = sorted({satellite_name(int(n)) for n in measured(raw_drive, EPOCHS - 1).satellite})
    assert lacking.split(", ")[:3] == [f"{name} none" for name in satellites[:3]]
    assert run.service.healthy()  # epochs come; that none has a position is in the counters
    assert run.bus.counters["epochs.none"] == run.bus.counters["not_fixed.too_few_satellites"] == EPOCHS


def test_with_some_ephemerides_the_fix_is_of_those_satellites(raw_drive: RawDrive) -> None:
    run = Run(raw_drive, base=lambda k: without(raw_drive, k, {1042, 1045, 1046}))
    assert len(run.fixed()) > EPOCHS // 2
    assert run.bus.fixes[0].satellites is not None
    assert run.bus.fixes[0].satellites < len(set(measured(raw_drive, 0).satellite.tolist()))
    assert run.bus.named()["ephemeris_missing"].startswith(f"{EPOCHS} epochs; C")


def test_a_base_that_falls_silent_makes_its_corrections_old_and_then_none(raw_drive: RawDrive) -> None:
    silent = streams(raw_drive, base=lambda k: raw_drive.rtcm_parts[k] if k < 5 else b"")
    run = Run(raw_drive, silent, epochs=30, engine={"longest_base_age_s": 1.0})
    assert run.fixed()[-1].age_of_corrections_s == pytest.approx(1.0)
    assert run.bus.qualities()[-10:] == ["single"] * 10
    assert run.bus.counters["not_fixed.base_too_old"] == 15
    assert "base_stale" in run.bus.named()


def test_a_base_that_never_speaks_leaves_single_points(raw_drive: RawDrive) -> None:
    def tick(k: int) -> list[Sent]:
        return [("ephemerides", "rtcm", raw_drive.rtcm_parts[k]), ("rover", "ubx", raw_drive.ubx_parts[k])]

    run = Run(raw_drive, tick)
    assert run.bus.qualities() == ["single"] * EPOCHS
    assert run.bus.counters["not_fixed.no_base"] == EPOCHS
    assert run.bus.named().keys() == {"base_silent"}


def test_a_base_that_does_not_say_where_it_is_is_named(raw_drive: RawDrive) -> None:
    run = Run(raw_drive, base=lambda k: without(raw_drive, k, {1005}))
    assert run.bus.qualities() == ["single"] * EPOCHS
    assert run.bus.counters["not_fixed.no_base_position"] == EPOCHS
    text = run.bus.named()["base_position_missing"]
    assert text == f"{EPOCHS} epochs; expected 1005, 1006 or a RINEX header in its stream, or base_ecef_m"


def test_a_base_with_another_stations_coordinate_is_named_with_how_far_it_is_off(raw_drive: RawDrive) -> None:
    x, y, z = station(raw_drive)
    run = Run(raw_drive, base_ecef_m=(x + 120.0, y, z))
    assert run.bus.qualities() == ["single"] * EPOCHS
    assert run.bus.counters["not_fixed.base_position_wrong"] == EPOCHS
    _, _, text = run.bus.named()["base_position_wrong"].partition("; its coordinate: ")
    assert text.endswith(" m up from its single point")
    offsets_m = [float(part.split()[0]) for part in text.split(", ")]
    assert 110.0 < np.linalg.norm(offsets_m) < 130.0


def test_a_receivers_clock_that_jumps_by_milliseconds_moves_no_fix(raw_drive: RawDrive) -> None:
    run = Run(raw_drive, rover=measuring(raw_drive, lambda k, epoch: clock_ahead(epoch, 1e-3 * (k >= 6))))
    assert len(run.fixed()) == EPOCHS
    assert run.bus.named().keys() == {"rover_clock_step"}


def test_a_satellite_that_is_there_twice_counts_once(raw_drive: RawDrive) -> None:
    def doubled(k: int) -> bytes:
        raw = bytearray(format_raw_measurements(measured(raw_drive, k))[6:-2])
        raw[11] *= 2
        return ubx_frame(0x02, 0x15, bytes(raw + raw[16:]))

    twice = Run(raw_drive, rover=doubled)
    once = Run(raw_drive, rover=measuring(raw_drive, lambda k, epoch: epoch))
    assert len(twice.fixed()) == EPOCHS
    assert [fix.height_m for fix in twice.bus.fixes] == [fix.height_m for fix in once.bus.fixes]
    assert twice.bus.counters["rover.repeated_signals"] > 0
    assert "repeated_signals" in twice.bus.named()["damaged_input"]


def test_an_epoch_without_satellites_has_no_position_and_the_next_one_has(raw_drive: RawDrive) -> None:
    def blind(k: int, epoch: ObservationEpoch) -> ObservationEpoch:
        return some_rows(epoch, NONE) if k in (3, 4) else epoch

    run = Run(raw_drive, rover=measuring(raw_drive, blind))
    assert len(run.fixed()) == EPOCHS - 2
    assert run.bus.counters["epochs.none"] == 2
    assert run.service.healthy()


def test_sixty_satellites_of_which_most_are_made_up_move_no_fix(raw_drive: RawDrive) -> None:
    rng = np.random.default_rng(8)

    def crowded(k: int, epoch: ObservationEpoch) -> ObservationEpoch:
        seen = set(epoch.satellite.tolist())
        more = [n for system in "GEC" for n in range(ord(system) * 256 + 1, ord(system) * 256 + 33)]
        more = [n for n in more if n not in seen][: 60 - len(seen)]
        signals = [signal_number("2I" if n >> 8 == ord("C") else "1C") for n in more]
        rows = np.arange(epoch.satellite.size)
        return replace(
            some_rows(epoch, np.append(rows, np.zeros(len(more), np.int64))),
            satellite=np.append(epoch.satellite, more),
            signal=np.append(epoch.signal, signals),
            pseudorange_m=np.append(epoch.pseudorange_m, rng.uniform(2e7, 2.6e7, len(more))),
            carrier_phase_cycles=np.append(epoch.carrier_phase_cycles, rng.uniform(1e8, 1.4e8, len(more))),
            doppler_hz=np.append(epoch.doppler_hz, rng.uniform(-4e3, 4e3, len(more))),
            cn0_dbhz=np.append(epoch.cn0_dbhz, np.full(len(more), 45.0)),
        )

    run = Run(raw_drive, rover=measuring(raw_drive, crowded))
    assert len(set(crowded(0, measured(raw_drive, 0)).satellite.tolist())) == 60
    assert len(run.fixed()) > EPOCHS // 2


def test_epochs_that_come_late_or_twice_are_not_solved_again(raw_drive: RawDrive) -> None:
    order = [0, 1, 1, 3, 2, 4]
    run = Run(raw_drive, lambda k: streams(raw_drive)(order[k]), epochs=6, delay_ns=NS // 5)
    assert [fix.time_ns for fix in run.fixed()] == [raw_drive.times_ns[k] for k in (0, 1, 3, 4)]
    assert {"repeated_epoch", "out_of_order_epoch"} <= run.bus.named().keys()


@pytest.mark.parametrize("protocol", ["ubx", "mixed"])
def test_a_receivers_positions_come_from_the_same_stream_and_nothing_is_solved(
    protocol: Any, raw_drive: RawDrive
) -> None:
    bus = GnssBus()
    service = GnssService(GnssSettings(), cast(Bus, bus))
    assert service.handlers().keys() == {"receiver_bytes"}
    for k in range(EPOCHS):
        bus.time_ns = raw_drive.times_ns[k] + NS // 20
        message = received(bus.time_ns, raw_drive.ubx_parts[k], protocol=protocol)
        service.handlers()["receiver_bytes"](message)
        service.advance(bus.time_ns)
    # Without NAV-EOE an epoch is whole when the next one begins.
    assert [fix.time_ns for fix in bus.fixes] == raw_drive.times_ns[: EPOCHS - 1]
    assert {fix.origin for fix in bus.fixes} == {"receiver"}
    assert bus.issues == []
    names = [message for message in bus.published if isinstance(message, ReceiverIntegrity)]
    assert [message.time_ns for message in names] == raw_drive.times_ns[: EPOCHS - 1]
    assert {type(message) for message in bus.published} == {Fix, ReceiverIntegrity}


@pytest.mark.parametrize(("every_s", "expected_ms"), [(0.0, range(0, 1500, 100)), (1.0, (0, 1000))])
def test_satellites_in_view_are_published_as_often_as_set(
    every_s: float, expected_ms: Iterable[int], raw_drive: RawDrive
) -> None:
    run = Run(raw_drive, epochs=15, satellites_every_s=every_s)
    views = [message for message in run.bus.published if isinstance(message, SatellitesInView)]
    assert [(view.time_ns - raw_drive.times_ns[0]) // 1_000_000 for view in views] == list(expected_ms)
    assert {view.quality for view in views} == {"fixed"}
    assert all((view.use == SATELLITE_USES.index("used")).sum() >= 10 for view in views)
