"""RXM-RAWX beside pyubx2: a receiver's stream, frames and checksums included, to observations in physical units."""

from __future__ import annotations

import io
import math

import numpy as np
from figure import Figure, higher, per_call_us
from pyubx2 import UBXReader

from camber.formats.observations import ObservationEpoch, satellite_number, signal_number
from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.ubx.reader import UbxDecoder
from camber.formats.ubx.writer import format_raw_measurements

START_NS = 1_400_000_000_000_000_000
SIGNALS = {"G": ("1C", "2L"), "E": ("1C", "7Q"), "C": ("2I", "7I"), "J": ("1C", "2L")}
MOST_SATELLITES = {"J": 5}
GNSS_IDS = {0: "G", 2: "E", 3: "C", 5: "J"}
SEED = 3
EPOCHS = 300
PEER_EPOCHS = 10


def one_epoch(random: np.random.Generator, time_ns: int) -> ObservationEpoch:
    """Of each system 8 to 12 satellites (QZSS: fewer) on two signals."""
    names = [
        (f"{system}{number:02d}", signal)
        for system, signals in SIGNALS.items()
        for number in range(6, 6 + min(int(random.integers(8, 13)), MOST_SATELLITES.get(system, 99)))
        for signal in signals
    ]
    n = len(names)
    return ObservationEpoch(
        time_ns=time_ns,
        satellite=np.array([satellite_number(name) for name, _ in names]),
        signal=np.array([signal_number(signal) for _, signal in names]),
        pseudorange_m=random.uniform(2.0e7, 2.6e7, n),
        carrier_phase_cycles=random.uniform(1.0e8, 1.4e8, n),
        doppler_hz=random.uniform(-4000.0, 4000.0, n),
        cn0_dbhz=np.rint(random.uniform(30.0, 50.0, n)),
        lock_time_s=np.full(n, 60.0),
        loss_of_lock=np.zeros(n, np.bool_),
        half_cycle=np.zeros(n, np.bool_),
    )


def decoded(data: bytes) -> list[ObservationEpoch]:
    """Of a stream that comes in pieces of 4096 bytes."""
    decoder = UbxDecoder("benchmark")
    results = [result for at in range(0, len(data), 4096) for result in decoder.feed(data[at : at + 4096])]
    return [result.epoch for result in results if isinstance(result, ReceiverEpoch)]


def decoded_by_pyubx2(data: bytes) -> list[list[tuple[str, float, float, float, float]]]:
    """Satellite, pseudorange, phase, Doppler, C/N0 of each measurement of each epoch."""
    return [
        [
            (
                f"{GNSS_IDS[getattr(message, f'gnssId_{k:02d}')]}{getattr(message, f'svId_{k:02d}'):02d}",
                *(getattr(message, f"{name}_{k:02d}") for name in ("prMes", "cpMes", "doMes", "cno")),
            )
            for k in range(1, message.numMeas + 1)
        ]
        for _, message in UBXReader(io.BytesIO(data))
    ]


def assert_equal(
    ours: list[ObservationEpoch], peer: list[list[tuple[str, float, float, float, float]]]
) -> None:
    for epoch, rows in zip(ours, peer, strict=True):
        columns = zip(
            epoch.satellite.tolist(),
            epoch.pseudorange_m.tolist(),
            epoch.carrier_phase_cycles.tolist(),
            epoch.doppler_hz.tolist(),
            epoch.cn0_dbhz.tolist(),
            strict=True,
        )
        for (satellite, *values), (name, *expected) in zip(columns, rows, strict=True):
            assert satellite == satellite_number(name)
            assert values == expected, f"{name}: {values}, pyubx2 {expected}"
            assert all(math.isfinite(value) for value in values)


def figures() -> list[Figure]:
    random = np.random.default_rng(SEED)
    frames = [
        format_raw_measurements(one_epoch(random, START_NS + second * 1_000_000_000))
        for second in range(EPOCHS)
    ]
    data, part = b"".join(frames), b"".join(frames[:PEER_EPOCHS])
    assert_equal(decoded(part), decoded_by_pyubx2(part))
    ours = 1e6 * EPOCHS / per_call_us(lambda: decoded(data))
    peer = 1e6 * PEER_EPOCHS / per_call_us(lambda: list(UBXReader(io.BytesIO(part))))
    name = f"UBX RXM-RAWX of about 70 measurements, seed {SEED}"
    return [
        higher(name, "messages/s", ours, peer, "pyubx2, same values, without lock times from epoch to epoch")
    ]
