"""Whole files of observations, ephemerides and solutions, and streams in pieces."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.errors import FormatError
from camber.formats.observations import BroadcastEphemeris, ObservationEpoch
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.rinex.compressed_files import rinex_chunks
from camber.formats.rinex.navigation_reader import NavigationDecoder, NavigationResult
from camber.formats.rinex.observation_header import ObservationHeader
from camber.formats.rinex.observation_reader import ObservationResult, RinexDecoder
from camber.formats.rinex.writer import StationHeader, observation_lines
from camber.geodesy.ellipsoid import ecef_from_geodetic_scalar


@dataclass(frozen=True, kw_only=True)
class RinexObservations:
    """An observation file; `skipped` satellites by system letter."""

    header: ObservationHeader
    epochs: list[ObservationEpoch]
    problems: list[FormatError]
    skipped: Mapping[str, int]


@dataclass(frozen=True, kw_only=True)
class RinexNavigation:
    """A navigation file."""

    ephemerides: list[BroadcastEphemeris]
    klobuchar: Mapping[str, IonosphereCoefficients]
    leap_seconds: int | None
    problems: list[FormatError]


def recording(name: str) -> Path:
    """The folder of a recording in CAMBER_DATA; the test is skipped without it."""
    if "CAMBER_DATA" not in os.environ:
        pytest.skip("CAMBER_DATA is not set")
    return Path(os.environ["CAMBER_DATA"]) / name


def recorded_place_m(file: Path) -> NDArray[np.float64]:
    """ECEF (3,) of the latitude, longitude and ellipsoidal height in a file."""
    latitude_deg, longitude_deg, height_m = map(float, file.read_text().replace(",", " ").split())
    return np.array(ecef_from_geodetic_scalar(np.deg2rad(latitude_deg), np.deg2rad(longitude_deg), height_m))


def read_observations(path: Path) -> RinexObservations:
    """Read a file, plain or compressed; FormatError where nothing of it can be read."""
    decoder = RinexDecoder(path.name)
    results: list[ObservationResult] = _decoded(decoder, path)
    problems = [r for r in results if isinstance(r, FormatError)]
    if decoder.header is None:
        raise problems[0]
    epochs = [r for r in results if isinstance(r, ObservationEpoch)]
    return RinexObservations(header=decoder.header, epochs=epochs, problems=problems, skipped=decoder.skipped)


def read_navigation(path: Path) -> RinexNavigation:
    """Read a file, plain or compressed; FormatError where nothing of it can be read."""
    decoder = NavigationDecoder(path.name)
    results: list[NavigationResult] = _decoded(decoder, path)
    problems = [r for r in results if isinstance(r, FormatError)]
    if decoder.version is None:
        raise problems[0]
    return RinexNavigation(
        ephemerides=[r for r in results if isinstance(r, BroadcastEphemeris)],
        klobuchar=decoder.klobuchar,
        leap_seconds=decoder.leap_seconds,
        problems=problems,
    )


def _decoded(decoder, path: Path) -> list:
    results = []
    try:
        for chunk in rinex_chunks(path):
            results += decoder.feed(chunk)
    except FormatError as error:
        results.append(error)
    return results + decoder.finish()


def fed_in_pieces(decoder: Any, data: bytes, cuts: Iterable[int] = ()) -> list[Any]:
    """Return the results of a decoder, to its end, of data that arrive cut at these places."""
    edges = [0, *sorted(cut for cut in cuts if cut < len(data)), len(data)]
    return [r for a, b in pairwise(edges) for r in decoder.feed(data[a:b])] + decoder.finish()


def comparable(results: Iterable[Any]) -> list[Any]:
    """Return the results with errors as their texts."""
    return [str(result) if isinstance(result, FormatError) else result for result in results]


def nmea_sentence(content: str) -> bytes:
    checksum = 0
    for byte in content.encode("ascii"):
        checksum ^= byte
    return f"${content}*{checksum:02X}\r\n".encode("ascii")


def read_pos(path: Path) -> list[ReceiverSolution | FormatError]:
    """Read an RTKLIB solution file."""
    decoder = PosDecoder(path.name)
    return decoder.feed(path.read_bytes()) + decoder.finish()


def observation_text(epochs: Sequence[ObservationEpoch], station: StationHeader) -> str:
    """Return a whole observation file."""
    return "".join(observation_lines(epochs, station))
