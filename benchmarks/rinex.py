"""RINEX observation files to epochs of columns, beside a reader that takes each line apart with Python's own means.

The recording `rooftop` of $CAMBER_DATA (11.6 kB an epoch: 57 satellites, up to four signals), repeated; without the
variable there is no figure. georinex (3 to 4 epochs/s on the same file) is too slow to be run here.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from figure import Figure, higher, per_call_us

from camber.formats.observations import ObservationEpoch, satellite_name, signal_name
from camber.formats.rinex.observation_reader import RinexDecoder
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_gpst

FILE = "rooftop-2024-06-24/rover.obs"
REPEATED = 12
PIECE_BYTES = 65_536
PEER_EPOCHS = 60

PlainEpoch = tuple[int, dict[str, dict[str, float]]]


def split(data: bytes) -> tuple[bytes, list[bytes]]:
    """The header, and each epoch's bytes."""
    begin = data.index(b"\n>") + 1
    return data[:begin], [b">" + part for part in data[begin:].split(b">")[1:]]


def decoded(pieces: list[bytes]) -> list[ObservationEpoch]:
    decoder = RinexDecoder("benchmark")
    results = [result for piece in pieces for result in decoder.feed(piece)]
    epochs = [result for result in results if isinstance(result, ObservationEpoch)]
    assert len(epochs) == len(results)
    return epochs


def decoded_plainly(text: str) -> list[PlainEpoch]:
    """Time, and by satellite the values of its types; systems that Camber does not read are passed over too."""
    lines = iter(text.splitlines())
    types: dict[str, list[str]] = {}
    system = ""
    for line in lines:
        if line[60:].startswith("SYS / # / OBS TYPES"):
            system = line[0].strip() or system
            types.setdefault(system, []).extend(line[7:60].split())
        if line[60:].startswith("END OF HEADER"):
            break
    epochs: list[PlainEpoch] = []
    for head in lines:
        year, month, day, hour, minute = map(int, head[2:18].split())
        whole, fraction = head[18:29].split(".")
        when = CalendarTime(year, month, day, hour, minute, int(whole), int(fraction) * 100)
        satellites: dict[str, dict[str, float]] = {}
        for _ in range(int(head[32:35])):
            line = next(lines)
            if line[0] not in "GJEC":
                continue
            cells = {name: line[3 + 16 * k : 17 + 16 * k].strip() for k, name in enumerate(types[line[0]])}
            satellites[line[:3]] = {name: float(cell) for name, cell in cells.items() if cell}
        epochs.append((gps_ns_from_gpst(when), satellites))
    return epochs


def assert_equal(ours: list[ObservationEpoch], peer: list[PlainEpoch]) -> None:
    for epoch, (time_ns, satellites) in zip(ours, peer, strict=True):
        assert epoch.time_ns == time_ns
        columns = zip(
            map(satellite_name, epoch.satellite.tolist()),
            map(signal_name, epoch.signal.tolist()),
            np.column_stack(
                (epoch.pseudorange_m, epoch.carrier_phase_cycles, epoch.doppler_hz, epoch.cn0_dbhz)
            ).tolist(),
            strict=True,
        )
        for satellite, signal, row in columns:
            for kind, value in zip("CLDS", row, strict=True):
                if value == value:
                    assert satellites[satellite].pop(kind + signal) == value
        assert not any(name[0] in "CLDS" for values in satellites.values() for name in values)


def figures() -> list[Figure]:
    if "CAMBER_DATA" not in os.environ:
        return []
    head, epochs = split((Path(os.environ["CAMBER_DATA"]) / FILE).read_bytes())
    short = head + b"".join(epochs[:PEER_EPOCHS])
    assert_equal(decoded([short]), decoded_plainly(short.decode()))
    data = head + b"".join(epochs) * REPEATED
    pieces = [data[at : at + PIECE_BYTES] for at in range(0, len(data), PIECE_BYTES)]
    one_by_one = [head, *epochs]
    count = len(epochs) * REPEATED
    whole_per_s = 1e6 * count / per_call_us(lambda: decoded(pieces))
    single_per_s = 1e6 * len(epochs) / per_call_us(lambda: decoded(one_by_one))
    peer_per_s = 1e6 * PEER_EPOCHS / per_call_us(lambda: decoded_plainly(short.decode()))
    peer = "a plain Python reader, same values"
    return [
        higher("RINEX observations, 64 kB pieces", "epochs/s", whole_per_s, peer_per_s, peer),
        higher("RINEX observations, an epoch at a time", "epochs/s", single_per_s, peer_per_s, peer),
    ]
