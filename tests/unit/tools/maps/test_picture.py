from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from camber.cli import main
from camber.road_map.release import read_release
from camber.tools.maps.picture import picture
from support.refusals import Refused
from support.small_map import link, surface, write


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A road to the east of 10 to 20 m, and a bridge over its middle at 30 m; both 8 m wide and 40 m long."""
    folder = tmp_path_factory.mktemp("release")
    size = {"half_length_m": 20.0, "half_width_m": 4.0}
    road = surface(1, heights_m=[[10.0, 10.0], [20.0, 20.0]], **size)
    bridge = surface(2, level=1, yaw_rad=0.5 * math.pi, heights_m=30.0, **size)
    write(folder, [road, bridge], [link(1, (1, 2), [(-20.0, -2.0), (20.0, -2.0)])])
    return folder


def pixels(png: bytes) -> np.ndarray:
    image = imread(io.BytesIO(png), format="png")
    return np.round(255.0 * image[..., :3]).astype(int)


def test_the_road_rises_from_blue_to_yellow_and_the_bridge_lies_over_it(release: Path) -> None:
    png, output = picture(read_release(release), "t", None, 200)
    image = pixels(png)
    height, width, _ = image.shape
    m_a_pixel = 2.0 * (math.hypot(20.0, 4.0) + 5.0) / width

    def at(east_m: float, north_m: float) -> list[int]:
        return image[int(height / 2 - north_m / m_a_pixel), int(width / 2 + east_m / m_a_pixel)].tolist()

    assert at(24.0, 20.0) == [255, 255, 255]  # nothing
    west, east, bridge = at(-18.0, 2.0), at(18.0, 2.0), at(0.5, 2.0)
    assert west[2] > west[0]
    assert bridge[0] > 200 > bridge[2]  # the highest: yellow
    assert east[1] > west[1]
    assert at(0.0, 17.0) == bridge
    assert at(-10.0, -2.0) == [205, 60, 80]  # the link over the surface
    assert "2 surfaces, heights 15.0 to 30.0 m" in output


def test_one_tile_or_the_whole_map_into_a_file_and_a_tile_that_is_not_there_is_refused(
    release: Path, tmp_path: Path, refused: Refused
) -> None:
    x, y = read_release(release).tiles("surfaces")[0]
    command = ["map", "picture", str(release), "--out", str(tmp_path / "map.png"), "--pixels", "100"]
    assert main(command) == 0
    whole = pixels((tmp_path / "map.png").read_bytes())
    assert max(whole.shape[:2]) == 100
    assert main([*command, "--tile", str(x), str(y)]) == 0
    tile = pixels((tmp_path / "map.png").read_bytes())
    assert 0 < (tile != 255).any(axis=2).mean() < (whole != 255).any(axis=2).mean()
    assert "tiles" in refused(main, *command, "--tile", "0", "0")
