"""Skies at random places and times, between houses or in the open: what a receiver would track, row by row.

Places: one half over Japan, where BeiDou's and QZSS's inclined satellites are, one half anywhere within 60° of
latitude. A street is 15 to 30 m wide, with houses of 8 to 50 m on each side; hidden by a house a signal is blocked, or
(3 %) comes by a wall alone. Of what is seen in a street the second frequency is lost with 40 %, and the phase of every
other satellite carries a reflection of 1 to 3 cm (σ 7 to 21 mm), of one in twenty one as large as they come (σ 30 mm).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.geodesy.ellipsoid import ecef_from_geodetic
from camber.geodesy.gps_time import NS_PER_SECOND, CalendarTime, gps_ns_from_gpst
from camber.gnss.observations.differenced_observations import Noise, variance_m2
from camber.gnss.observations.signal_pairs import WAVELENGTH_M
from camber.simulator.satellites.constellation import true_ephemerides
from camber.simulator.satellites.orbits import OrbitTable, newest_in_use, satellite_states
from camber.simulator.scene import Booleans, Floats, Integers

ROWS = 96  # more than two bands of all satellites above one place
LATER_S = 60.0  # chosen: satellites have moved, and nothing else
SYSTEMS = ("G", "GJ", "GE", "GJE", "GJC", "GJEC")
_PLACE, _BANDS = {"G": 0, "J": 0, "E": 1, "C": 2}, {"G": (1, 2), "J": (1, 2), "E": (1, 7), "C": (2, 7)}
_FEWEST = 5  # four unknowns and one to check them
_LOWEST_SINE = math.sin(math.radians(10.0))
_AT_ONCE = 256  # chosen: places whose satellites are computed together
_NOON_NS = gps_ns_from_gpst(CalendarTime(2026, 3, 20, *(12, 0, 0)))
_HALF_DAY_S = 43_200  # a definition


class RandomSkies(NamedTuple):
    """n skies of at most `ROWS` rows, a row a satellite in one band; only the first `rows` (n,) of each count.

    `direction` and `later_direction` (n, ROWS, 3): from the satellite to the receiver, east, north, up, now and
    `LATER_S` later. `code_sigma_m`, `phase_sigma_m`: what an engine assumes of the difference to a base (n, ROWS).
    `reflection_m`, `code_bias_sigma_m`, `detour_m`: σ of the phase's reflection, of the code's, and what a code by
    walls alone is too long by. `street` (n,), `street_rad` (n,) its direction from east.
    """

    rows: Integers
    direction: Floats
    later_direction: Floats
    satellite: Integers
    group: Integers
    wavelength_m: Floats
    code_sigma_m: Floats
    phase_sigma_m: Floats
    reflection_m: Floats
    code_bias_sigma_m: Floats
    detour_m: Floats
    street: Booleans
    street_rad: Floats


def random_skies(count: int, rng: np.random.Generator) -> RandomSkies:
    """So many, each with five satellites at least."""
    table = OrbitTable.of(newest_in_use(true_ephemerides(_NOON_NS, _NOON_NS, 1), _NOON_NS))
    letters = [chr(int(number) >> 8) for number in table.satellite]
    satellites = _Constellation(
        number=table.satellite,
        place=np.array([_PLACE[letter] for letter in letters]),
        bands=np.array([_BANDS[letter] for letter in letters]),
        in_systems=np.array([[letter in systems for letter in letters] for systems in SYSTEMS]),
    )
    skies, done = _empty(count), 0
    while done < count:
        place = _places(_AT_ONCE, rng)
        seconds = rng.integers(-_HALF_DAY_S, _HALF_DAY_S, _AT_ONCE).astype(np.float64)
        line, later = (_lines_of_sight(table, *place, seconds + after_s) for after_s in (0.0, LATER_S))
        for k in range(_AT_ONCE):
            if done < count and _fill(skies, done, (line[k], later[k]), satellites, rng=rng, noise=Noise()):
                done += 1
    return skies


def _empty(n: int) -> RandomSkies:
    shape: dict[str, tuple[int, ...]] = dict.fromkeys(RandomSkies._fields, (n, ROWS))
    shape |= dict.fromkeys(("rows", "street", "street_rad"), (n,))
    shape |= dict.fromkeys(("direction", "later_direction"), (n, ROWS, 3))
    of = {"rows": np.int64, "satellite": np.int64, "group": np.int64, "street": np.bool_}
    return RandomSkies._make(np.zeros(shape[name], of.get(name, np.float64)) for name in RandomSkies._fields)


class _Constellation(NamedTuple):
    number: Integers
    place: Integers
    bands: Integers
    in_systems: Booleans


def _places(n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    japan = rng.random(n) < 0.5
    sine = rng.uniform(-math.sin(math.radians(60.0)), math.sin(math.radians(60.0)), n)
    latitude = np.where(japan, np.radians(rng.uniform(30.0, 45.0, n)), np.arcsin(sine))
    longitude = np.radians(np.where(japan, rng.uniform(129.0, 145.0, n), rng.uniform(-180.0, 180.0, n)))
    return latitude, longitude


def _lines_of_sight(
    table: OrbitTable, latitude_rad: Floats, longitude_rad: Floats, seconds: Floats
) -> Floats:
    """Unit vectors (n, m, 3) to the satellites, east, north, up; light time turns them by 1e-5 rad and is left out."""
    time_ns = _NOON_NS + np.round(seconds * NS_PER_SECOND).astype(np.int64)
    states = satellite_states(table, time_ns, np.zeros((len(time_ns), len(table.satellite))))
    place = np.asarray(ecef_from_geodetic(latitude_rad, longitude_rad, np.zeros(len(time_ns))))
    line = states.position_m - place[:, None, :]
    line = line / np.linalg.norm(line, axis=-1, keepdims=True)
    s, c, sl, cl = np.sin(latitude_rad), np.cos(latitude_rad), np.sin(longitude_rad), np.cos(longitude_rad)
    zero = np.zeros_like(s)
    axes = (-sl, cl, zero), (-s * cl, -s * sl, c), (c * cl, c * sl, s)
    turn = np.stack([np.stack(axis, -1) for axis in axes], axis=1)
    return np.asarray(np.einsum("nij,nmj->nmi", turn, line))


@compiled
def _fill(
    skies: RandomSkies,
    at: int,
    lines: tuple[Floats, Floats],
    satellites: _Constellation,
    rng: np.random.Generator,
    noise: Noise,
) -> bool:
    """One sky's rows; False where there are too few satellites."""
    line, later = lines
    of_systems = satellites.in_systems[rng.integers(0, satellites.in_systems.shape[0])]
    both_bands = rng.random() < 0.5
    between, along_rad = rng.random() < 0.75, rng.uniform(0.0, math.pi)
    width_m, share = rng.uniform(15.0, 30.0), rng.uniform(0.2, 0.8)
    left_m, right_m = rng.uniform(6.5, 48.5), rng.uniform(6.5, 48.5)
    row, seen = 0, 0
    for k in range(satellites.number.size):
        sine = line[k, 2]
        across = line[k, 1] * math.cos(along_rad) - line[k, 0] * math.sin(along_rad)
        wall_m = (1.0 - share) * width_m if across > 0.0 else share * width_m
        roof = (left_m if across > 0.0 else right_m) * abs(across) / wall_m
        if not of_systems[k] or sine < _LOWEST_SINE:
            continue
        blocked = between and sine < roof
        if blocked and rng.random() > 0.03:
            continue
        reflection, kind = 0.003, rng.random()
        if between and kind < 0.5:
            reflection = 0.030 if kind < 0.05 else rng.uniform(0.007, 0.021)
        detour = rng.exponential(10.0) if blocked else 0.0
        for number in range(2 if both_bands else 1):
            if row == ROWS or (number == 1 and rng.random() < (0.4 if between else 0.05)):
                continue
            group = 4 * (10 * satellites.place[k] + satellites.bands[k, number])
            base_dbhz = 49.0 - 13.0 * (1.0 - sine) - 2.0 * number
            code, phase = 0.0, 0.0
            for level_dbhz in (base_dbhz - (8.0 if blocked else 0.0), base_dbhz):
                code += variance_m2(noise.code_background_m, noise.code_noise_m, sine, level_dbhz)
                phase += variance_m2(noise.phase_background_m, noise.phase_noise_m, sine, level_dbhz)
            skies.direction[at, row], skies.later_direction[at, row] = -line[k], -later[k]
            skies.satellite[at, row], skies.group[at, row] = satellites.number[k], group
            skies.wavelength_m[at, row] = WAVELENGTH_M[group]
            skies.code_sigma_m[at, row], skies.phase_sigma_m[at, row] = math.sqrt(code), math.sqrt(phase)
            skies.reflection_m[at, row], skies.detour_m[at, row] = reflection, detour
            skies.code_bias_sigma_m[at, row] = 1.5 if between else 0.3
            row += 1
        seen += 1
    skies.rows[at], skies.street[at], skies.street_rad[at] = row, between, along_rad
    return seen >= _FEWEST
