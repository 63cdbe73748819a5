from __future__ import annotations

import contextlib
import io
from pathlib import Path

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.map_exchange.las import cloud_from_las, read_las

laspy = pytest.importorskip("laspy")

POINTS = np.random.default_rng(7).uniform((4e5, 3.9e6, 0.0), (400_500.0, 3_900_500.0, 500.0), (200, 3))


def las(*, compressed: bool, version: str = "1.4", crs: str | None = None) -> bytes:
    header = laspy.LasHeader(point_format=6 if version == "1.4" else 3, version=version)
    header.scales, header.offsets = [0.001] * 3, [400_000.0, 3_900_000.0, 0.0]
    if crs is not None:
        import pyproj

        header.add_crs(pyproj.CRS(crs))
    file = laspy.LasData(header)
    file.x, file.y, file.z = POINTS.T
    classes = np.full(len(POINTS), 2, np.uint8)
    classes[:5] = 7
    file.classification = classes
    stream = io.BytesIO()
    file.write(stream, do_compress=compressed)
    return stream.getvalue()


@pytest.mark.parametrize("version", ["1.2", "1.4"])
@pytest.mark.parametrize("name", ["cloud.las", "cloud.laz"])
def test_points_come_back_to_the_file_s_millimetre_and_noise_is_left_out(
    tmp_path: Path, name: str, version: str
) -> None:
    path = tmp_path / name
    path.write_bytes(las(compressed=name.endswith("z"), version=version))
    cloud = read_las(path)
    assert np.abs(cloud.points - POINTS[5:]).max() < 0.00051
    assert cloud.crs_wkt is None


def test_the_reference_system_is_handed_on() -> None:
    wkt = cloud_from_las(las(compressed=False, crs="EPSG:32654"), "f").crs_wkt
    assert wkt is not None
    assert "UTM zone 54N" in wkt


@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_that_breaks_off_is_one_clear_line_wherever_it_does(*, compressed: bool) -> None:
    data = las(compressed=compressed)
    for length in [*range(0, 400, 23), *np.linspace(400, len(data) - 40, 25).astype(int).tolist()]:
        with pytest.raises(FormatError) as refused:
            cloud_from_las(data[:length], "cut.laz")
        assert str(refused.value).startswith("cut.laz")
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("compressed", [False, True])
def test_a_header_that_promises_billions_of_points_is_refused_before_they_are_allocated(
    *, compressed: bool
) -> None:
    data = bytearray(las(compressed=compressed))
    data[247:255] = (400_000_000).to_bytes(8, "little")
    with pytest.raises(FormatError, match="400000000 points"):
        cloud_from_las(bytes(data), "f")


def test_damage_raises_nothing_else() -> None:
    """Of LAZ the header only: lazrs takes a damaged size within a chunk at its word and allocates gigabytes."""
    rng = np.random.default_rng(11)
    for compressed, reach in ((False, 1200), (True, 375)):
        whole = las(compressed=compressed)
        for _ in range(150):
            data = bytearray(whole)
            for place in rng.integers(0, reach, 4).tolist():
                data[place] = int(rng.integers(256))
            with contextlib.suppress(FormatError):
                cloud_from_las(bytes(data), "f")
