"""`camber map inspect` and `diff`: what a release, a store and a map hold, and what another release says otherwise."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from camber import cli
from camber.road_map.release import read_release
from camber.road_map.release_files import ROOT_NAME
from camber.road_map.store import MapStore
from camber.tools.maps.diff import compared
from camber.tools.maps.inspect import inspected
from camber.tools.maps.release_at import release_at
from support import lanelet_maps, opendrive_maps
from support.lanelet_maps import lanelet2_bytes
from support.opendrive_maps import opendrive_bytes
from support.refusals import Refused
from support.release_world import KEY, OTHER_KEY
from support.small_map import link, surface, write

LINE = [(-10.0, 0.0), (10.0, 0.0)]


def a_release(folder: Path, **changed: object) -> Path:
    rows = [surface(1), surface(2, 20.0, level=1, sigma_m=0.05), surface(3, 40.0)]
    write(folder, rows, [link(1, (1, 2), LINE)], **changed)
    return folder


def test_a_release_is_reported_by_levels_sigmas_and_signer(tmp_path: Path) -> None:
    mine, other = tmp_path / "mine.pub", tmp_path / "other.pub"
    for pem, key in ((mine, KEY), (other, OTHER_KEY)):
        pem.write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    folder = a_release(tmp_path / "map", signing_key=KEY, surrogate="made up")
    report = inspected(folder, mine)
    assert report["surfaces"]["count"] == 3
    assert report["surfaces"]["by level"] == {"0": 2, "1": 1}
    assert report["surfaces"]["sigma"] == "median 0.030 m, 90 % 0.046 m, most 0.050 m"
    assert report["links"]["count"] == 1
    assert report["links"]["length"] == "0.020 km"
    assert report["surrogate"] == "made up"
    assert report["signature"].endswith(", right")
    assert inspected(folder)["signature"].endswith(", not checked")
    assert cli.main(["map", "inspect", str(folder), "--public-key", str(other)]) == 2


def stored(folder: Path, path: Path, without: str | None = None) -> None:
    """The release in a vehicle's store, all of it but one blob."""
    release = read_release(folder)
    store = MapStore(path)
    store.accept((folder / ROOT_NAME).read_bytes(), file="root", region=None, public_key=None)
    for digest in (*release.hashes(), release.root.manifest_sha256):
        if digest != without:
            store.put(digest, (folder / "blobs" / digest[:2] / digest).read_bytes())
    store.put_in_force(release.root.map_version)
    store.close()


def test_a_store_is_reported_as_its_release_and_missing_tiles_are_counted(tmp_path: Path) -> None:
    folder = a_release(tmp_path / "map")
    stored(folder, tmp_path / "map.sqlite")
    assert inspected(tmp_path / "map.sqlite") == inspected(folder)
    release = read_release(folder)
    lacking = release.sha256("surfaces", *release.tiles("surfaces")[0])
    stored(folder, tmp_path / "part.sqlite", without=lacking)
    assert inspected(tmp_path / "part.sqlite")["tiles not fetched"] == 1


def test_a_damaged_store_is_one_line_and_stays_where_it_is(tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "map.sqlite"
    path.write_bytes(b"SQLite format 3\x00" + bytes(500))
    line = refused(cli.main, "map", "inspect", path)
    assert line.startswith(f"camber map inspect: {path}: store, expected a readable store of the map")
    assert [entry.name for entry in tmp_path.iterdir()] == ["map.sqlite"]


def test_a_map_that_is_not_imported_yet_says_what_must_be_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "town.osm").write_bytes(lanelet2_bytes(lanelet_maps.town()))
    (tmp_path / "town.xodr").write_bytes(opendrive_bytes(opendrive_maps.town()))
    lanelets = inspected(tmp_path / "town.osm")
    assert lanelets["lanelets"] == {"road": 5}
    assert lanelets["vertical datum"].startswith("not stated")
    assert cli.main(["map", "inspect", str(tmp_path / "town.xodr")]) == 0
    output = capsys.readouterr().out
    assert "+proj=utm +zone=32" in output
    assert cli.main(["map", "inspect", str(tmp_path / "town.xodr"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["geometries"] == {
        "line": 3,
        "spiral": 2,
        "arc": 2,
        "paramPoly3": 1,
    }


@pytest.mark.parametrize("name", ["town.shp", "nothing"])
def test_what_is_no_map_is_one_line(name: str, tmp_path: Path, refused: Refused) -> None:
    if name != "nothing":
        (tmp_path / name).write_bytes(b"x")
    line = refused(cli.main, "map", "inspect", tmp_path / name)
    assert line.startswith(f"camber map inspect: {tmp_path / name}: ")


def test_a_difference_names_surfaces_heights_lineage_and_tiles(tmp_path: Path) -> None:
    a = a_release(tmp_path / "a")
    tilted = np.array([[50.0, 50.0], [50.1, 50.1]])
    rows = [
        surface(1, heights_m=tilted),
        surface(2, 20.0, level=0, sigma_m=0.05),
        surface(4, 40.0),
        surface(5, 44.0),
    ]
    b = tmp_path / "b"
    write(b, rows, [link(1, (1, 2), LINE), link(9, (2, 3), LINE)], map_version=8, lineage=[(4, 3), (5, 3)])
    report = compared(release_at(a), release_at(b))
    assert report["surfaces added"] == [4, 5]
    assert report["surfaces removed"] == [3]
    assert report["surfaces moved"] == []
    assert report["other columns changed"] == [2]
    assert report["heights changed"] == [{"surface": 1, "mean_m": 0.05, "least_m": 0.0, "most_m": 0.1}]
    assert report["links added"] == [9]
    assert report["links removed"] == []
    assert report["lineage"] == [[4, 3], [5, 3]]
    assert {row["layer"] for row in report["tiles"]} == {"surfaces", "links"}
    assert all(min(row["bytes"]) > 0 for row in report["tiles"])


def test_a_finer_grid_of_the_same_heights_and_equal_releases_are_no_difference(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plane = np.array([[50.0, 50.2], [50.1, 50.3]])
    finer = np.array([[50.0, 50.1, 50.2], [50.05, 50.15, 50.25], [50.1, 50.2, 50.3]])
    write(tmp_path / "a", [surface(1, heights_m=plane)])
    write(tmp_path / "b", [surface(1, heights_m=finer)])
    report = compared(release_at(tmp_path / "a"), release_at(tmp_path / "b"))
    assert report["heights changed"] == []
    assert len(report["tiles"]) >= 1
    assert cli.main(["map", "diff", str(tmp_path / "a"), str(tmp_path / "a")]) == 0
    assert "tiles changed          0: 0 → 0 bytes" in capsys.readouterr().out


def test_a_surface_that_was_moved_under_its_id_is_named(tmp_path: Path) -> None:
    write(tmp_path / "a", [surface(1), surface(2, 30.0)])
    write(tmp_path / "b", [surface(1), surface(2, 30.2)])
    assert compared(release_at(tmp_path / "a"), release_at(tmp_path / "b"))["surfaces moved"] == [2]
