"""Each place of the world has one shard, and a contribution that spans shards is divided the same each time."""

import math

import numpy as np
import pytest

from camber.map_update.stores.shards import Shards
from camber.road_map.tile_grid import tiles_of
from camber.schemas.road import ZOOM
from support.contributions import contribution

QUARTERS = Shards(["0", "1", "2", "3"])


def test_quarters_of_the_world_are_north_west_north_east_south_west_south_east():
    latitude = np.radians([60.0, 60.0, -60.0, -60.0])
    longitude = np.radians([-100.0, 100.0, -100.0, 100.0])
    assert [QUARTERS.name(shard) for shard in QUARTERS.of(latitude, longitude)] == ["0", "1", "2", "3"]


def test_the_quadkey_of_a_tile_follows_from_its_numbers():
    # Of the standard's example: tile x 3, y 5 at zoom 3 is 213.
    shards = Shards(["0", "1", "3", "20", "22", "23", "210", "211", "212", "213"])
    longitude = 2.0 * math.pi * 3.5 / 8 - math.pi
    latitude = math.atan(math.sinh(math.pi * (1.0 - 2.0 * 5.5 / 8)))
    assert shards.name(int(shards.of([latitude], [longitude])[0])) == "213"


def test_a_point_is_in_the_shard_of_its_tile_at_any_depth():
    rng = np.random.default_rng(5)
    latitude, longitude = np.radians(rng.uniform(-84.0, 84.0, 500)), rng.uniform(-math.pi, math.pi, 500)
    x, y = tiles_of(latitude, longitude)
    shards = Shards(["0", "2", "3", *(f"1{a}{b}" for a in "0123" for b in "0123")])
    for name, column, row in zip(map(shards.name, shards.of(latitude, longitude)), x, y, strict=True):
        digits = [(row >> bit & 1) * 2 + (column >> bit & 1) for bit in reversed(range(ZOOM))]
        assert "".join(map(str, digits)).startswith(name)


def test_one_shard_covers_the_poles_too():
    whole = Shards([""])
    assert whole.name(0) == "world"
    assert whole.of(np.radians([89.0, -89.0, 0.0]), [0.0, 0.0, 3.0]).tolist() == [0, 0, 0]
    assert QUARTERS.of(np.radians([89.0]), [1.0]).tolist() == [0]


@pytest.mark.parametrize(
    ("keys", "complaint"),
    [
        (["0", "1", "2"], "no shard has the tile 3000"),
        (["0", "1", "2", "3", "30"], "more than one shard has the tile 30"),
        (["0", "0", "1", "2", "3"], "more than one shard has the tile 0"),
        ([], "no shard has the tile 0"),
        (["", "4"], "'4': expected up to"),
    ],
)
def test_shards_with_a_gap_or_an_overlap_are_refused(keys, complaint):
    with pytest.raises(ValueError, match=complaint):
        Shards(keys)


def test_a_contribution_within_a_shard_stays_whole_and_one_across_is_divided_row_by_row():
    batch, single = contribution("b1", kind="batch", records=6), contribution("u1")
    assert QUARTERS.split([batch, single]) == [[(1, batch)], [(1, single)]]
    batch.observations["longitude_rad"][[1, 4]] *= -1.0
    batch.observations["latitude_rad"][4] *= -1.0
    parts, other = QUARTERS.split([batch, single])
    assert other == [(1, single)]
    assert [(QUARTERS.name(shard), part.name) for shard, part in parts] == [(k, batch.name) for k in "012"]
    times = [(part.observations["time_ns"] - batch.observations["time_ns"][0]).tolist() for _, part in parts]
    assert times == [[1], [0, 2, 3, 5], [4]]
    (again,) = QUARTERS.split([batch])
    assert [part.digest() for _, part in again] == [part.digest() for _, part in parts]


def test_a_contribution_without_records_belongs_to_the_first_shard():
    empty = contribution("b0", kind="batch", records=0)
    assert QUARTERS.split([empty]) == [[(0, empty)]]
    assert QUARTERS.split([]) == []
