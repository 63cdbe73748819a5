"""Compare the heights of a release with those of its source at random places, by a second evaluation of the source."""

from __future__ import annotations

import argparse
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.map_exchange.vertical_datum import VerticalDatum
from camber.road_map.height_interpolation import SurfaceHeights
from camber.road_map.road_columns import RoadSurfaces
from camber.tools.maps.importers.lanes import Floats, Integers, Lane, named_id
from camber.tools.options.number_options import SEED

PLACES = 2000
"""Chosen: a lane of a thousandth of the map is met with 86 %, and all of it takes a second or two."""
_MOST_SIGMAS = (
    3.0  # chosen: 99.7 % of a normal distribution; the error of reading a map should be far below its σ
)
_NEAR_M = (
    0.02  # chosen: a place on a border may be outside of its rectangle by rounding and a chord's sagitta
)
_MOST_BARE = (
    0.01  # chosen: surfaces cover their lanes; some places are lost to the rounding of very narrow ones
)
_MOST_CUTS = 20  # chosen: more turns than any helix has


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the places where heights are compared."""
    text = "of the random places where heights are compared with the source (else random, and printed)"
    parser.add_argument("--check-seed", type=SEED, metavar="N", help=text)


def seed_of(args: argparse.Namespace) -> int:
    """The seed that `args` name, or a random one."""
    return secrets.randbelow(1 << 32) if args.check_seed is None else int(args.check_seed)


@dataclass(frozen=True, eq=False, kw_only=True)
class SourceHeights:
    """Heights of the source (n,) at places; `links`: ids that the link there may have, `names` of the places."""

    latitude_rad: Floats
    longitude_rad: Floats
    height_m: Floats
    links: Sequence[Sequence[int]]
    names: Sequence[str]


class NamedPlace(Protocol):
    """A place of a source."""

    @property
    def name(self) -> str:
        """The lane, as the import names it."""

    @property
    def at(self) -> str:
        """Where on it."""


P = TypeVar("P", bound=NamedPlace)


def heights_on_lanes(
    places: Sequence[P],
    lanes: Sequence[Lane],
    geodetic: Callable[[Sequence[P]], tuple[Floats, Floats, Floats]],
    *,
    vertical: VerticalDatum,
    file: str,
) -> SourceHeights:
    """Return the heights of a source at its places on lanes that are taken.

    `geodetic`: latitudes, longitudes [rad] and heights in the source's datum [m] of places, each (n,).
    """
    # A lane may be cut into several links.
    links = {
        lane.name: [lane.link_id, *(named_id("link", lane.name, k) for k in range(_MOST_CUTS))]
        for lane in lanes
    }
    taken = [place for place in places if place.name in links]
    latitude, longitude, height_m = geodetic(taken)
    return SourceHeights(
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=vertical.ellipsoidal_m(latitude, longitude, height_m, file),
        links=[links[place.name] for place in taken],
        names=[f"{place.name}, {place.at}" for place in taken],
    )


def checked_heights(
    surfaces: RoadSurfaces, source: SourceHeights, *, seed: int, file: str, most_beyond: float = 0.0
) -> str:
    """Return one line about the differences; FormatError, which names the place, for one beyond 3 σ, or if more than a
    hundredth of the places on a link have no surface.

    Where several surfaces of a link are at a place, the one that differs most counts. Places of lanes without
    surfaces, which were left out, do not. `most_beyond`: share of places that may be beyond, where σ has a random part.
    """
    place, off_m, sigmas, bare = _differences(surfaces, source)
    if len(bare) > _MOST_BARE * (len(place) + len(bare)) and not most_beyond:
        expected = f"a surface (seed {seed}); {len(bare)} of {len(place) + len(bare)} places have none"
        raise FormatError(file, f"height at {source.names[bare[0]]}", expected)
    if not len(place):
        return f"{file}: heights not compared with the source: no place of it is on a surface"
    beyond = ~(sigmas <= _MOST_SIGMAS)
    if beyond.mean() > most_beyond:
        worst = int(np.argmax(np.where(np.isfinite(sigmas), sigmas, np.inf)))
        actual = f"{off_m[worst]:.3f} m, {sigmas[worst]:.1f} sigma off"
        expected = f"the source's within {_MOST_SIGMAS:g} σ (seed {seed})"
        raise FormatError(file, f"height at {source.names[place[worst]]}", expected, actual=actual)
    p50, p99, most = np.quantile(off_m, (0.5, 0.99, 1.0)) * 1e3
    return (
        f"{file}: heights against the source at {len(place)} places (seed {seed}): median {p50:.1f} mm, "
        f"99 % {p99:.1f} mm, most {most:.1f} mm, {sigmas.max():.1f} σ"
    )


def _differences(
    surfaces: RoadSurfaces, source: SourceHeights
) -> tuple[Sequence[int], Floats, Floats, Sequence[int]]:
    """Numbers of places (n,) with surfaces, their differences [m] and in σ; and numbers of places without."""
    evaluated = SurfaceHeights(surfaces)
    rows_of: dict[int, Integers] = {
        int(link): np.flatnonzero(surfaces.link_id == link) for link in np.unique(surfaces.link_id)
    }
    place, bare, differences = [], [], []
    for k, links in enumerate(source.links):
        rows = np.concatenate([np.zeros(0, np.int64), *(rows_of[link] for link in links if link in rows_of)])
        if not len(rows):
            continue
        at = np.full(len(rows), source.latitude_rad[k]), np.full(len(rows), source.longitude_rad[k])
        height_m, outside_m = evaluated.heights_m(rows, *at)
        on = outside_m <= _NEAR_M
        if not on.any():
            bare.append(k)
            continue
        off_m = np.abs(height_m[on] - source.height_m[k])
        sigmas = off_m / surfaces.sigma_m[rows[on]]
        worst = int(np.argmax(sigmas))
        place.append(k)
        differences.append((off_m[worst], sigmas[worst]))
    table = np.array(differences).reshape(-1, 2)
    return place, table[:, 0], table[:, 1], bare
