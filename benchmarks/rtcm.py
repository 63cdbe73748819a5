"""RTCM 3 MSM7 beside pyrtcm: a base station's stream, frames and CRC included, to observations in physical units."""

from __future__ import annotations

import io

import numpy as np
from figure import Figure, higher, per_call_us
from pyrtcm import RTCMReader

from camber.formats.observations import ObservationEpoch, carrier_hz, satellite_number, signal_number
from camber.formats.rtcm.reader import BaseStationEpoch, RtcmDecoder
from camber.formats.rtcm.writer import format_observations

START_NS = 1_400_000_000_000_000_000
SPEED_OF_LIGHT_M_S = 299_792_458.0
SIGNALS = {"G": ("1C", "2L"), "E": ("1C", "7Q"), "C": ("2I", "7I")}
SEED = 3
EPOCHS = 100
PEER_MESSAGES = 30


def one_epoch(random: np.random.Generator, time_ns: int) -> ObservationEpoch:
    """Of each system 10 to 25 satellites on two signals."""
    names = [
        (f"{system}{number:02d}", signal)
        for system, signals in SIGNALS.items()
        for number in range(1, int(random.integers(10, 26)) + 1)
        for signal in signals
    ]
    n = len(names)
    wavelength_m = SPEED_OF_LIGHT_M_S / np.array([carrier_hz(name[0], signal) for name, signal in names])
    range_m = np.repeat(random.uniform(2.0e7, 2.6e7, n // 2), 2)
    rate_m_s = np.repeat(random.uniform(-800.0, 800.0, n // 2), 2)
    return ObservationEpoch(
        time_ns=time_ns,
        satellite=np.array([satellite_number(name) for name, _ in names]),
        signal=np.array([signal_number(signal) for _, signal in names]),
        pseudorange_m=range_m + random.uniform(-5.0, 5.0, n),
        carrier_phase_cycles=(range_m + random.uniform(-100.0, 100.0, n)) / wavelength_m,
        doppler_hz=-rate_m_s / wavelength_m,
        cn0_dbhz=random.uniform(30.0, 50.0, n),
        lock_time_s=np.full(n, 100.0),
        loss_of_lock=np.zeros(n, np.bool_),
        half_cycle=np.zeros(n, np.bool_),
    )


def decoded(data: bytes) -> int:
    """Observations in a stream that comes in pieces of 4096 bytes."""
    decoder = RtcmDecoder(START_NS)
    results = [result for at in range(0, len(data), 4096) for result in decoder.feed(data[at : at + 4096])]
    return sum(result.epoch.satellite.size for result in results if isinstance(result, BaseStationEpoch))


def decoded_by_pyrtcm(data: bytes) -> int:
    return sum(message.NCell for _, message in RTCMReader(io.BytesIO(data)))


def figures() -> list[Figure]:
    random = np.random.default_rng(SEED)
    frames = [
        frame
        for second in range(EPOCHS)
        for frame in format_observations(one_epoch(random, START_NS + second * 1_000_000_000), station_id=1)
    ]
    data, part = b"".join(frames), b"".join(frames[:PEER_MESSAGES])
    assert decoded(part) == decoded_by_pyrtcm(part)
    ours = 1e6 * len(frames) / per_call_us(lambda: decoded(data))
    peer = 1e6 * PEER_MESSAGES / per_call_us(lambda: decoded_by_pyrtcm(part))
    name = f"RTCM MSM7 of 10 to 25 satellites on two signals, seed {SEED}"
    return [higher(name, "messages/s", ours, peer, "pyrtcm, which does not put them together to epochs")]
