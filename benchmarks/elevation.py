"""Elevations of a city on two levels: by pose and by id in batches beside rasterio, single ones over the bus beside
bare Zenoh, and single ones in the process beside SciPy.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bare_zenoh
import numpy as np
from figure import Figure, higher, least_s, lower, per_call_us, percentiles
from scipy.interpolate import RegularGridInterpolator

from camber.geodesy.local_frame import LocalFrame
from camber.map_server.batch_road_selection import SelectedRoads
from camber.map_server.elevation_queries import ElevationMap
from camber.road_map.height_interpolation import SurfaceHeights
from camber.road_map.release import read_release, write_release
from camber.road_map.road_columns import RoadLinks, RoadSurfaces
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import decode, encode, encoding_of
from camber.schemas.road import ElevationReply, ElevationRequest

MADE_NS = 1_400_000_000 * 10**9
FRAME = LocalFrame(math.radians(35.17), math.radians(136.9), 0.0)
STREETS, SURFACES = 52, 100
"""So many streets eastwards on the ground, as many northwards above them, each of so many surfaces."""
APART_M, LENGTH_M, WIDTH_M = 40.0, 20.0, 7.0
PER_LINK = 5
CLEARANCE_M = 6.0
CELL_M = 0.3
POINTS = 1_000_000
SAMPLED = 20_000
"""Points asked of rasterio: a million would take it a minute, at the same rate."""
QUERIES = 3000
GOAL_PER_S, GOAL_BY_ID_PER_S, GOAL_TIMES_RASTER, GOAL_TIMES_BARE = 1e6, 3e6, 300.0, 2.0
SEED = 77

Floats = np.ndarray
Integers = np.ndarray


def ground_m(east_m: Floats, north_m: Floats) -> Floats:
    return 50.0 + 3.0 * np.sin(east_m / 200.0) + 2.0 * np.cos(north_m / 150.0)


class City:
    """Streets as a table; surface `street × surfaces + place`, the northward streets after the eastward ones."""

    def __init__(self, streets: int = STREETS, surfaces: int = SURFACES) -> None:
        self.streets = streets
        street, place = (a.ravel() for a in np.mgrid[0 : 2 * streets, 0:surfaces])
        self.above = street >= streets
        self.east_m, self.north_m = self.plane_m(street, (place + 0.5) * LENGTH_M, np.zeros(len(street)))
        latitude, longitude, _ = self.geodetic(self.east_m, self.north_m)
        steps = np.linspace(-0.5, 0.5, 3)
        along_m, across_m = (a.ravel() for a in np.meshgrid(steps * LENGTH_M, steps * WIDTH_M, indexing="ij"))
        east_m, north_m = self.plane_m(
            street[:, None],
            (place[:, None] + 0.5) * LENGTH_M + along_m,
            np.broadcast_to(across_m, (len(street), 9)),
        )
        heights_m = ground_m(east_m, north_m) + CLEARANCE_M * self.above[:, None]
        self.link = street * (surfaces // PER_LINK) + place // PER_LINK
        # Ids as they come after years of splits and merges: far apart, in no order.
        self.surface_id = np.random.default_rng(SEED).permutation(len(street)) * 7919 + 1_000_000
        self.surfaces = RoadSurfaces(
            surface_id=self.surface_id,
            link_id=self.link,
            level=self.above.astype(np.int64),
            latitude_rad=latitude,
            longitude_rad=longitude,
            yaw_rad=np.where(self.above, math.pi / 2.0, 0.0),
            half_length_m=np.full(len(street), LENGTH_M / 2.0),
            half_width_m=np.full(len(street), WIDTH_M / 2.0),
            sigma_m=np.full(len(street), 0.02),
            vehicles=np.full(len(street), 10),
            last_seen_ns=np.full(len(street), MADE_NS),
            heights_m=list(heights_m.reshape(-1, 3, 3)),
        )
        per_street = surfaces // PER_LINK
        link = np.arange(2 * streets * per_street)
        nth = link % per_street
        ends_m = np.stack((nth, nth + 1), axis=1) * LENGTH_M * PER_LINK
        lines_m = self.plane_m((link // per_street)[:, None], ends_m, np.zeros(ends_m.shape))
        vertices = self.geodetic(*(axis.ravel() for axis in lines_m))
        self.links = RoadLinks(
            link_id=link,
            start_node=link + link // per_street,
            end_node=link + link // per_street + 1,
            level=(link >= len(link) // 2).astype(np.int64),
            sigma_m=np.full(len(link), 0.5),
            vertices=list(np.column_stack(vertices[:2]).reshape(-1, 2, 2)),
        )

    def write(self, folder: Path) -> None:
        """Its release."""
        write_release(
            folder,
            region="city",
            map_version=1,
            datum="WGS84",
            epoch_year=2024.5,
            time_ns=MADE_NS,
            surfaces=self.surfaces,
            links=self.links,
        )

    def plane_m(self, street: Integers, along_m: Floats, left_m: Floats) -> tuple[Floats, Floats]:
        """East and north of places on streets."""
        above, offset_m = street >= self.streets, street % self.streets * APART_M
        return np.where(above, offset_m - left_m, along_m), np.where(above, along_m, offset_m + left_m)

    @staticmethod
    def geodetic(east_m: Floats, north_m: Floats) -> tuple[Floats, Floats, Floats]:
        return FRAME.geodetic_from_east_north_array(np.column_stack((east_m, north_m)), 0.0)

    def drives(self, count: int) -> Drives:
        """Poses along all streets one after the other, each with its link, the one ahead and its last surface."""
        rng = np.random.default_rng(SEED + 1)
        driven_m = np.sort(rng.uniform(0.0, 2 * STREETS * SURFACES * LENGTH_M, count))
        row = (driven_m // LENGTH_M).astype(np.int64)
        street, along_m = row // SURFACES, driven_m % (SURFACES * LENGTH_M)
        left_m = rng.uniform(-0.3, 0.3, count) * WIDTH_M
        return Drives(self, row, *self.plane_m(street, along_m, left_m))


class Drives:
    """Poses on known surfaces."""

    def __init__(self, city: City, row: Integers, east_m: Floats, north_m: Floats) -> None:
        self.city, self.row, self.east_m, self.north_m = city, row, east_m, north_m
        self.latitude_rad, self.longitude_rad, _ = city.geodetic(east_m, north_m)
        self.surface_id = city.surface_id[row]
        before = np.where(row % SURFACES, row - 1, row)
        self.last_surface_id = city.surface_id[before]
        ahead = np.minimum(row + PER_LINK, row // SURFACES * SURFACES + SURFACES - 1)
        self.link_ids = np.column_stack((city.link[row], city.link[ahead]))

    def shuffled(self) -> Drives:
        order = np.random.default_rng(SEED + 2).permutation(len(self.row))
        return Drives(self.city, self.row[order], self.east_m[order], self.north_m[order])

    def rows(self) -> list[tuple[float, float, list[int], int]]:
        """Latitude, longitude, links and last surface of each pose."""
        columns = (self.latitude_rad, self.longitude_rad, self.link_ids, self.last_surface_id)
        return list(zip(*(column.tolist() for column in columns), strict=True))

    def on_ground(self, count: int) -> Drives:
        rows = np.flatnonzero(~self.city.above[self.row])[:count]
        return Drives(self.city, self.row[rows], self.east_m[rows], self.north_m[rows])


def write_raster(path: Path) -> None:
    """Heights of the ground in cells of 0.3 m, tiled as rasters for random access are."""
    import rasterio
    from rasterio.transform import from_origin

    cells = math.ceil((SURFACES * LENGTH_M + 100.0) / CELL_M)
    west_m, top_m = -50.0, cells * CELL_M - 50.0
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=cells,
        height=cells,
        count=1,
        dtype="float32",
        transform=from_origin(west_m, top_m, CELL_M, CELL_M),
        tiled=True,
        blockxsize=256,
        blockysize=256,
    ) as raster:
        east_m = west_m + (np.arange(cells) + 0.5) * CELL_M
        north_m = top_m - (np.arange(cells) + 0.5) * CELL_M
        raster.write(ground_m(east_m[None, :], north_m[:, None]).astype(np.float32), 1)


def map_of(folder: Path) -> ElevationMap:
    release = read_release(folder)
    manifest = release.manifest
    return ElevationMap(
        release.surface_tile, release.link_tile, datum=manifest.datum, map_version=manifest.map_version
    )


def batches(city: City, folder: Path) -> list[Figure]:
    import rasterio

    roads, heights = map_of(folder), SurfaceHeights(city.surfaces)
    along = city.drives(POINTS)
    write_raster(folder / "ground.tif")
    figures = []
    with rasterio.open(folder / "ground.tif") as raster:
        for order, drives in (("along drives", along), ("in random order", along.shuffled())):

            def by_pose(d: Drives = drives) -> SelectedRoads:
                return roads.roads_each(d.latitude_rad, d.longitude_rad, d.link_ids, d.last_surface_id)

            def alike(d: Drives = drives) -> SelectedRoads:
                return roads.roads(d.latitude_rad, d.longitude_rad)

            def by_id(d: Drives = drives) -> tuple[Floats, Floats]:
                return heights.heights_m(heights.rows_of(d.surface_id), d.latitude_rad, d.longitude_rad)

            on_ground = drives.on_ground(SAMPLED)
            places = list(zip(on_ground.east_m.tolist(), on_ground.north_m.tolist(), strict=True))

            def sampled(places: list[tuple[float, float]] = places) -> Floats:
                return np.array(list(raster.sample(places)))[:, 0]

            roads_by_pose = by_pose()
            truth_m = ground_m(drives.east_m, drives.north_m) + CLEARANCE_M * city.above[drives.row]
            assert len(roads_by_pose.known) == len(drives.row)
            assert (roads_by_pose.level == city.above[drives.row]).all()
            assert np.abs(roads_by_pose.elevation_m - truth_m).max() < 0.01
            assert np.abs(by_id()[0] - truth_m).max() < 0.01
            assert np.abs(sampled() - ground_m(on_ground.east_m, on_ground.north_m)).max() < 0.01
            assert set(np.unique(alike().reason)) == {0, 2}  # known, and ambiguous where streets cross
            peer_per_s = SAMPLED / least_s(sampled, rounds=3)
            for name, call, goal in (
                ("by pose, links and last surface", by_pose, GOAL_PER_S),
                ("by pose, without topology", alike, GOAL_PER_S),
                ("by surface id", by_id, GOAL_BY_ID_PER_S),
            ):
                per_s = POINTS / least_s(call)
                peer = f"rasterio.sample of {SAMPLED:,} of these points, ground alone; goal {GOAL_TIMES_RASTER:g}"
                what = f"elevation {name}, {len(city.surface_id):,} surfaces, {order}"
                figures.append(higher(what, "/s", per_s, peer_per_s, peer))
                figures.append(higher(what, "/s", per_s, goal, "goal"))
    return figures


@contextmanager
def served(folder: Path) -> Iterator[bare_zenoh.zenoh.Session]:
    """A session with a map server beside it."""
    endpoint = bare_zenoh.free_endpoint()
    config = folder.parent / "map_server.toml"
    config.write_text(f'release = "{folder}"\n[zenoh]\nconnect = ["{endpoint}"]\n')
    environment = {name: text for name, text in os.environ.items() if not name.startswith("CAMBER_")}
    session = bare_zenoh.open_peer(listen=endpoint)
    child = subprocess.Popen(
        [sys.executable, "-m", "camber.cli", "map_server", "--config", str(config)],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield session
    finally:
        child.terminate()
        child.wait()
        session.close()


def over_the_bus(city: City, folder: Path) -> list[Figure]:
    """Both by turns, so that both meet the same load; ours with its codec on both sides."""
    drives = city.drives(QUERIES)
    requests = [
        ElevationRequest(
            time_ns=MADE_NS, latitude_rad=a, longitude_rad=b, link_ids=tuple(links), last_surface_id=last
        )
        for a, b, links, last in drives.rows()
    ]
    channel = BY_NAME["elevation"]
    key = channel.key_for("vehicle").replace("{service}", "localizer")
    with served(folder) as ours:
        querier = ours.declare_querier(
            key, express=True, priority=bare_zenoh.zenoh.Priority.INTERACTIVE_HIGH, timeout=1.0
        )

        def ask(request: ElevationRequest) -> tuple[ElevationReply, int] | None:
            data = encode(request, source="localizer")
            for reply in querier.get(payload=data, encoding=encoding_of(ElevationRequest)):
                if reply.ok is not None:
                    answer = reply.ok.payload.to_bytes()
                    return decode(ElevationReply, answer, str(reply.ok.encoding)).message, len(answer)
            return None

        deadline = time.monotonic() + 60.0
        while (first := ask(requests[0])) is None or first[0].road.status != "known":
            if time.monotonic() > deadline:
                raise RuntimeError(f"the map server does not answer: {first}")
            time.sleep(0.2)
        sizes = {"question": len(encode(requests[0], source="localizer")), "answer": first[1]}
        spent: dict[str, list[float]] = {"ours": [], "bare": []}
        with bare_zenoh.processes(["map_server"], sizes) as session:
            bare = session.declare_querier(
                "bare/elevation", express=True, priority=bare_zenoh.zenoh.Priority.INTERACTIVE_HIGH
            )
            while not [reply for reply in bare.get(payload=b"\0" * sizes["question"]) if reply.ok]:
                time.sleep(0.2)
            for request in requests:
                began = time.perf_counter()
                reply = ask(request)
                between = time.perf_counter()
                for _ in bare.get(payload=b"\0" * sizes["question"]):
                    pass
                spent["bare"].append(time.perf_counter() - between)
                spent["ours"].append(between - began)
                assert reply is not None
                assert reply[0].road.status == "known"
    peer = f"bare Zenoh query of the same sizes by turns, n = {QUERIES}; goal {1.0 / GOAL_TIMES_BARE:g}"
    ours_ms, bare_ms = ([1e3 * s for s in spent[name]] for name in ("ours", "bare"))
    return percentiles("elevation, one question over the bus", "ms", ours_ms, bare_ms, peer)


def single(city: City, folder: Path) -> list[Figure]:
    roads, drives = map_of(folder), city.drives(100)
    points = drives.rows()
    grid = RegularGridInterpolator((np.arange(400.0), np.arange(400.0)), np.zeros((400, 400)))
    figures = []
    for name, radius_m in (("", 0.0), (", with the road 5 m around it", 5.0)):

        def ours(radius_m: float = radius_m) -> None:
            for latitude, longitude, links, last in points:
                roads.road_around(latitude, longitude, radius_m, links, last)

        def peer() -> None:
            for place in range(len(points)):
                grid((place + 0.5, 17.3))

        figures.append(
            lower(
                f"elevation of one point{name}",
                "µs",
                per_call_us(ours) / len(points),
                per_call_us(peer) / len(points),
                "SciPy RegularGridInterpolator, one point of one raster: no levels, no slope, no σ",
            )
        )
    return figures


def figures() -> list[Figure]:
    city = City()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "map"
        city.write(folder)
        return [*batches(city, folder), *single(city, folder), *over_the_bus(city, folder)]
