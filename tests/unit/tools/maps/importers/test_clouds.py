"""Clouds and a trajectory as maps: the road is where it was, what stands on it is not, and holes are not known."""

from __future__ import annotations

import builtins
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.formats.drive.truth_csv import TruthTable, write_truth
from camber.formats.map_exchange.pcd import PointCloud, write_pcd
from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import invert, map_from_vehicle, transform_points
from camber.road_map.release import read_release
from camber.road_map.road_columns import RoadSurfaces
from camber.tools.maps.importers.surfaces_along import Floats
from support.built_maps import build_map
from support.nearest_surface import nearest_heights
from support.refusals import Refused

pytest.importorskip("open3d")

ORIGIN = (35.1, 137.0, 40.0)
FRAME = LocalFrame(math.radians(ORIGIN[0]), math.radians(ORIGIN[1]), ORIGIN[2])
START_NS = 1_400_000_000 * 10**9
ABOVE_M = 1.7
SEED = 17
LOCAL = ("--origin", *ORIGIN)


def road(x: Any, y: Any) -> Any:
    """Up of the road in FRAME."""
    return 0.04 * x - 0.02 * y + 0.0005 * x**2


def scene() -> Floats:
    """A road to the east, 30 m long, with a wall, a car on it, birds, and nothing measured from 18 to 21 m."""
    rng = np.random.default_rng(SEED)
    x, y = rng.uniform((0.0, -4.0), (30.0, 4.0), (14_000, 2)).T
    ground = np.column_stack((x, y, road(x, y) + rng.normal(0.0, 0.008, len(x))))
    ground = ground[(x < 18.0) | (x > 21.0)]
    wall = np.column_stack((rng.uniform(0.0, 30.0, 3000), np.full(3000, 3.9), rng.uniform(0.0, 4.0, 3000)))
    wall[:, 2] += road(wall[:, 0], wall[:, 1])
    car = rng.uniform((8.0, 0.8, 0.25), (11.5, 2.2, 1.5), (2000, 3))
    car[:, 2] += road(car[:, 0], car[:, 1])
    under = (ground[:, 0] > 8.0) & (ground[:, 0] < 11.5) & (ground[:, 1] > 0.8) & (ground[:, 1] < 2.2)
    birds = rng.uniform((0.0, -4.0, 2.0), (30.0, 4.0, 9.0), (30, 3))
    return np.concatenate((ground[~under], wall, car, birds))


def poses() -> TruthTable:
    """Of the sensor, every metre."""
    x = np.arange(0.0, 30.1, 1.0)
    n = len(x)
    pitch = -np.arctan(0.04 + 0.001 * x)
    enu = np.column_stack((x, np.zeros(n), road(x, 0.0))) + ABOVE_M * np.column_stack(
        (np.sin(pitch), np.zeros(n), np.cos(pitch))
    )
    latitude, longitude, height = FRAME.geodetic_from_enu_array(enu)
    time_ns = START_NS + np.arange(n) * 10**8
    place = {"latitude_rad": latitude, "longitude_rad": longitude, "height_m": height}
    turn = {"roll_rad": np.zeros(n), "pitch_rad": pitch, "yaw_rad": np.zeros(n)}
    return TruthTable(time_ns=time_ns, **place, **turn, velocity_enu_m_s=np.zeros((n, 3)))


def build(folder: Path, *clouds: Path, more: tuple[object, ...] = LOCAL) -> int:
    write_truth(folder / "truth.csv", poses())
    options = ("--poses", folder / "truth.csv", "--above-road-m", ABOVE_M, "--width-m", 6, "--sigma-m", 0.01)
    return build_map("clouds", folder / "map", *clouds, *options, *more)


def at(surfaces: RoadSurfaces, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Height of the nearest surface less the road's, and how far outside it."""
    latitude, longitude, height = FRAME.geodetic_from_enu_array(np.column_stack((x, y, road(x, y))))
    height_m, outside_m = nearest_heights(surfaces, latitude, longitude)
    return height_m - height, outside_m


def test_the_road_is_where_it_was_and_not_where_nothing_was_measured(tmp_path: Path) -> None:
    points = scene()
    write_pcd(tmp_path / "cloud.pcd", PointCloud(points_m=points.astype(np.float32)))
    assert build(tmp_path, tmp_path / "cloud.pcd") == 0
    release = read_release(tmp_path / "map")
    surfaces = release.road_surfaces()
    x = np.arange(1.0, 29.0, 0.25)
    off_m, outside_m = at(surfaces, x, 0.0 * x - 1.0)
    inside = outside_m < 1e-3
    assert np.abs(off_m[inside]).max() < 0.02
    assert inside[(x < 17.0) | (x > 22.0)].all()
    assert outside_m[(x > 18.9) & (x < 20.1)].min() > 0.0
    car_off_m, car_outside_m = at(surfaces, np.array([9.75]), np.array([1.5]))
    assert abs(car_off_m[0]) < 0.05 or car_outside_m[0] > 0.0
    assert 0.01 < surfaces.sigma_m.min() <= surfaces.sigma_m.max() < 0.03
    assert {layer for layer in ("road_cloud", "environment_cloud") if release.tiles(layer)} == {  # type: ignore[arg-type]
        "road_cloud",
        "environment_cloud",
    }


def test_sweeps_at_their_times_las_and_ply_give_the_same_road(tmp_path: Path) -> None:
    import laspy
    import pyproj

    points, truth = scene(), poses()
    sweeps = tmp_path / "sweeps"
    sweeps.mkdir()
    enu = FRAME.enu_from_geodetic_array(truth.latitude_rad, truth.longitude_rad, truth.height_m)
    for k in range(5, 30, 10):
        pose = map_from_vehicle(*enu[k].tolist(), 0.0, float(truth.pitch_rad[k]), 0.0)
        near = np.abs(points[:, 0] - enu[k, 0]) < 6.0
        cloud = PointCloud(points_m=transform_points(invert(pose), points[near]).astype(np.float32))
        write_pcd(sweeps / f"{truth.time_ns[k]}.pcd", cloud)
    latitude, longitude, height = FRAME.geodetic_from_enu_array(points)
    utm = pyproj.Proj(32653)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [680_000.0, 3_880_000.0, 0.0]
    header.add_crs(pyproj.CRS("EPSG:32653"))
    file = laspy.LasData(header)
    east, north = utm(np.degrees(longitude), np.degrees(latitude))
    file.x, file.y, file.z = east, north, height
    file.write(str(tmp_path / "cloud.laz"))
    ply = "ply\nformat ascii 1.0\nelement vertex {}\n{}end_header\n{}".format(
        len(points),
        "".join(f"property double {axis}\n" for axis in "xyz"),
        "".join(f"{x:.4f} {y:.4f} {z:.4f}\n" for x, y, z in points),
    )
    (tmp_path / "cloud.ply").write_text(ply)
    x = np.arange(1.0, 17.0, 0.25)
    for name, more in (
        ("sweeps", ("--sweeps",)),
        ("cloud.laz", ("--vertical-datum", "ellipsoidal")),
        ("cloud.ply", LOCAL),
    ):
        folder = tmp_path / f"of_{name}"
        folder.mkdir()
        assert build(folder, tmp_path / name, more=more) == 0, name
        off_m, outside_m = at(read_release(folder / "map").road_surfaces(), x, 0.0 * x - 1.0)
        assert outside_m.max() < 0.5, name
        assert np.abs(off_m).max() < 0.02, name
    assert build(tmp_path, tmp_path / "cloud.laz", more=()) == 2  # its vertical datum is not named


def test_what_cannot_be_a_cloud_is_one_clear_line(tmp_path: Path, refused: Refused) -> None:
    write_pcd(tmp_path / "whole.pcd", PointCloud(points_m=scene()[:100].astype(np.float32)))
    (tmp_path / "cut.pcd").write_bytes((tmp_path / "whole.pcd").read_bytes()[:-200])
    (tmp_path / "cut.laz").write_bytes(b"LASF" + bytes(90))
    (tmp_path / "cut.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n")
    (tmp_path / "cloud.xyz").write_bytes(b"0 0 0\n")
    (tmp_path / "empty").mkdir()
    for name in ("cut.pcd", "cut.laz", "cut.ply", "cloud.xyz", "empty", "none.pcd"):
        assert name in refused(lambda _, name=name: build(tmp_path, tmp_path / name)), name
    assert "--origin" in refused(lambda _: build(tmp_path, tmp_path / "whole.pcd", more=()))
    assert build(tmp_path, tmp_path / "whole.pcd", more=("--sweeps",)) == 2  # its name is no time
    assert not (tmp_path / "map").exists()


def test_where_open3d_lacks_a_library_one_line_names_it(
    tmp_path: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def without_libusb(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "open3d":
            raise OSError("libusb-1.0.so.0: cannot open shared object file: No such file or directory")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_libusb)
    write_pcd(tmp_path / "whole.pcd", PointCloud(points_m=scene()[:100].astype(np.float32)))
    assert "libusb-1.0-0" in refused(lambda _: build(tmp_path, tmp_path / "whole.pcd"))
