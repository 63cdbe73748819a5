"""A release of the map as a survey of a district makes it: on the survey day, with a survey's errors.

On the drive day vehicles are parked elsewhere, trees have grown and some roads have been resurfaced.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from camber.geodesy.gps_time import gpst_from_gps_ns
from camber.geodesy.local_frame import LocalFrame
from camber.replay.coarse_links import thinned
from camber.road_map.map_error_model import MAP_ERRORS, MapErrorModel
from camber.road_map.release import write_release
from camber.road_map.road_columns import RoadLinks
from camber.schemas.road import CloudTile, ReleaseRoot
from camber.simulator.random_streams import stream
from camber.simulator.world.district import District
from camber.simulator.world.ray_tracing import ShapeTracer
from camber.simulator.world.roads import Roads
from camber.simulator.world.survey_clouds import scan_stations, surveyed_clouds
from camber.simulator.world.survey_surfaces import surveyed_surfaces

DATUM = "WGS84"
# Chosen: fine against the knots of the error, of which a small share is left to the thinning.
_STEP_M = 2.0
_KNOT_M = 50.0
_THINNING_SHARE = 1.0 / 6.0
SURVEYED_BEFORE_NS = 120 * 86_400 * 1_000_000_000
"""Between the survey day and the drive day."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyErrors:
    """How good the survey is. `clouds`: False leaves the point clouds out, which take nearly all of the time.

    `wrong_m`: link id → metres by which the heights of its surfaces are wrong, without the map knowing.
    """

    height_sigma_m: float = 0.03
    height_errors: MapErrorModel = MAP_ERRORS
    link_deviation_m: float = 6.0
    scan_spacing_m: float = 5.0
    voxel_m: float = 0.10
    clouds: bool = True
    wrong_m: Mapping[int, float] = field(default_factory=dict)


def write_survey(
    folder: Path,
    district: District,
    time_ns: int,
    errors: SurveyErrors | None = None,
    *,
    scanned_route: str | None = None,
) -> ReleaseRoot:
    """Write the release of a district as surveyed at `time_ns`.

    With `scanned_route` the clouds are scanned from the links of that route only: enough for a drive along it, and
    faster. Raises ReleaseError and OSError as `write_release`, KeyError for a route that the district does not have.
    """
    errors, seed, roads = errors or SurveyErrors(), district.seed, district.roads("survey")
    sigma_m, model = errors.height_sigma_m, errors.height_errors
    surfaces = surveyed_surfaces(roads, district.frame, seed, sigma_m=sigma_m, model=model, seen_ns=time_ns)
    off_m = [errors.wrong_m.get(link, 0.0) for link in surfaces.link_id.tolist()]
    heights_m = [h + off for h, off in zip(surfaces.heights_m, off_m, strict=True)]
    clouds: list[CloudTile] = []
    if errors.clouds:
        links = list(range(len(roads.link_id)))
        if scanned_route is not None:
            links = sorted({leg.link for leg in district.layout.routes[scanned_route].legs})
        tracer = ShapeTracer(district.shapes("survey"))
        stations = scan_stations(roads, links, errors.scan_spacing_m)
        clouds = surveyed_clouds(
            stations, tracer, district.frame, seed=seed, voxel_m=errors.voxel_m, seen_ns=time_ns
        )
    day = gpst_from_gps_ns(time_ns)
    return write_release(
        folder,
        region=district.kind,
        map_version=1,
        datum=DATUM,
        epoch_year=round(day.year + (day.month - 0.5) / 12.0, 2),
        time_ns=time_ns,
        surfaces=replace(surfaces, heights_m=heights_m),
        links=surveyed_links(roads, district.frame, seed, errors.link_deviation_m),
        clouds=clouds,
        surrogate=(
            f"simulated survey of district {district.kind}, seed {seed}: heights with {sigma_m:g} m of "
            f"noise (correlation {model.short_m:g} m and {model.long_m:g} m, common offset of σ "
            f"{model.common_offset_sigma_m:g} m), links up to {errors.link_deviation_m:g} m off"
        ),
    )


def surveyed_links(roads: Roads, frame: LocalFrame, seed: int, deviation_m: float) -> RoadLinks:
    """Links as coarse as those of maps that navigation uses: thinned, and metres off the road, but nowhere further than
    `deviation_m` off the centre line.

    Nodes are off by a vector each; along a link the error goes from that of its first node over errors across the road,
    drawn every 50 m, to that of its last node, always a mean of such errors, so that none is larger than the largest.
    """
    rng = stream(seed, "survey links")
    largest_m = deviation_m * (1.0 - _THINNING_SHARE)
    size = largest_m * rng.uniform(0.5, 1.0, len(roads.node_id))
    angle = rng.uniform(0.0, 2.0 * math.pi, len(roads.node_id))
    of_nodes = np.column_stack((size * np.cos(angle), size * np.sin(angle)))
    vertices = []
    for link in range(len(roads.link_id)):
        length = float(roads.length_m[link])
        s = np.linspace(0.0, length, math.ceil(length / _STEP_M) + 1)
        east, north, yaw = roads.centre_line(link, s)
        line = np.column_stack((east, north))
        knots = int(length // _KNOT_M) + 2
        across = largest_m * rng.uniform(0.5, 1.0, knots) * np.where(rng.random(knots) < 0.5, -1.0, 1.0)
        inner = np.interp(s, np.arange(knots) * _KNOT_M, across)
        left = np.column_stack((-np.sin(yaw), np.cos(yaw)))
        reach = min(_KNOT_M, 0.5 * length)
        at_start = np.clip(1.0 - s / reach, 0.0, 1.0)[:, None]
        at_end = np.clip(1.0 - (length - s) / reach, 0.0, 1.0)[:, None]
        error = at_start * of_nodes[roads.start_node[link] - 1] + at_end * of_nodes[roads.end_node[link] - 1]
        error += (1.0 - at_start - at_end) * inner[:, None] * left
        corners = thinned(line, deviation_m * _THINNING_SHARE)
        moved = (line + error)[corners]
        latitude, longitude, _ = frame.geodetic_from_east_north_array(moved, np.zeros(len(moved)))
        vertices.append(np.column_stack((latitude, longitude)))
    return RoadLinks(
        link_id=roads.link_id,
        start_node=roads.start_node,
        end_node=roads.end_node,
        level=roads.level,
        sigma_m=np.full(len(roads.link_id), 0.5 * deviation_m),
        vertices=vertices,
    )
