"""`camber map releases` and `camber map review`: what an operator sees, and what comes of it."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from camber.map_server.release_download import ReleaseDownload
from camber.map_update.fusion.publication_decision import DECISION, DECISIONS, REASONS, Decisions
from camber.map_update.fusion.surface_neighbours import build_neighbourhood
from camber.map_update.release.review import ReviewFolder
from camber.road_map.operator_keys import OperatorKeys
from camber.road_map.release import key_id, open_release, read_release
from camber.road_map.store import MapStore
from camber.tools.maps.command import main
from support.release_world import KEY, OTHER_KEY, Cloud, making, offsets
from support.small_map import MADE_NS, at, surface, surfaces


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three releases; of the last, surface 3 is 8 cm higher and surface 5 lower."""
    builder = making(tmp_path)
    for step, rows in enumerate((offsets(), offsets(s3=0.05), offsets(s3=0.08, s5=-0.04))):
        builder.build(rows, time_ns=MADE_NS + step)
    (tmp_path / "key").write_bytes(KEY.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return tmp_path / "out"


def output(capsys: pytest.CaptureFixture[str], *expected: Any, code: int = 0) -> str:
    assert main([str(argument) for argument in expected]) == code
    captured = capsys.readouterr()
    return captured.err if code else captured.out


def test_releases_are_listed_from_the_newest_to_the_reference(folder: Path, capsys: Any) -> None:
    rows = [line.split() for line in output(capsys, "releases", folder).splitlines()[1:]]
    assert [row[0] for row in rows] == ["10", "9", "8", "7"]
    assert [row[2:4] for row in rows] == [["2", "2"], ["1", "1"], ["0", "0"], ["reference", "0"]]


def test_a_user_without_a_name_as_in_a_container_is_known_by_number(
    folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nameless() -> str:
        raise KeyError("getpwuid(): uid not found: 10001")

    monkeypatch.setattr("getpass.getuser", nameless)
    assert output(capsys, "review", folder) == "nothing is held\n"
    key = folder.parent / "key"
    output(
        capsys, "releases", folder, "--roll-back", 9, "--signing-key", key, "--reason", "a ferry was mapped"
    )
    assert "to 9" in (log := output(capsys, "review", folder, "--log"))
    assert f"uid {os.getuid()}: a ferry was mapped, withdrew 2 changes" in log


def test_a_height_is_followed_to_the_release_it_is_from(folder: Path, capsys: Any) -> None:
    text = output(capsys, "releases", folder, "--why", 3)
    assert [line.split()[:2] for line in text.splitlines()[2:4]] == [["10", "+0.080"], ["9", "+0.050"]]
    assert "car" not in text


def test_a_roll_back_is_a_release_and_what_was_withdrawn_does_not_come_again(
    folder: Path, capsys: Any
) -> None:
    key = folder.parent / "key"
    expected = ("releases", folder, "--roll-back", 9, "--signing-key", key, "--who", "ann")
    assert "--reason" in output(capsys, *expected, code=2)
    text = output(capsys, *expected, "--reason", "a ferry was mapped")
    assert "version 11 has the corrections of 9; 2 were withdrawn" in text
    rolled = read_release(folder, public_key=KEY.public_key())
    assert rolled.road_surfaces().heights_m[3][0, 0] == pytest.approx(50.05)
    rows = np.zeros(1, DECISION)
    rows["surface_id"], rows["offset_m"], rows["decision"] = 5, -0.04, DECISIONS.index("publish")
    assert ReviewFolder(folder).apply(Decisions(surfaces=rows), MADE_NS).surfaces["decision"][
        0
    ] == DECISIONS.index("nothing")
    assert "reject at -0.040 m by ann: a ferry was mapped (back to version 9)" in output(
        capsys, "releases", folder, "--why", 5
    )
    assert "one of 11, 10, 9, 8, 7" in output(
        capsys, "releases", folder, "--roll-back", 77, "--signing-key", key, "--reason", "x", code=2
    )


def test_held_changes_are_listed_and_decided(folder: Path, capsys: Any) -> None:
    assert output(capsys, "review", folder) == "nothing is held\n"
    rows = np.zeros(1, DECISION)
    rows["surface_id"], rows["offset_m"], rows["decision"] = 4, 0.31, DECISIONS.index("hold")
    ReviewFolder(folder).apply(Decisions(surfaces=rows), MADE_NS)
    assert "+0.310 m" in output(capsys, "review", folder)
    assert "--why" in output(capsys, "review", folder, "--accept", 4, code=2)
    assert "one that is held" in output(capsys, "review", folder, "--accept", 9, "--why", "x", code=2)
    output(capsys, "review", folder, "--accept", 4, "--who", "ben", "--why", "new surface laid")
    assert "ben: new surface laid" in output(capsys, "review", folder, "--log")
    assert output(capsys, "review", folder, "--rejected") == "nothing is rejected\n"
    judged = ReviewFolder(folder).apply(Decisions(surfaces=rows), MADE_NS)
    assert judged.surfaces["decision"][0] == DECISIONS.index("publish")


def held_and_pending(folder: Path) -> None:
    """Held: surfaces 2 and 6, 800 m and 2400 m to the east; pending: 5, 2000 m."""
    rows = [surface(k, 400.0 * k, link_id=2**61 + 1) for k in range(8)]
    rows[6] |= {"surface_id": 2**61 + 3}
    neighbourhood = build_neighbourhood(surfaces(rows), street_m=300.0, region_m=1000.0)
    decided = np.zeros(3, DECISION)
    decided["surface_id"], decided["offset_m"] = (2, 5, 2**61 + 3), (0.31, 0.09, -0.7)
    decided["decision"] = [DECISIONS.index(name) for name in ("hold", "nothing", "hold")]
    decided["reason"], decided["votes"] = REASONS.index("too_few_days"), 4
    ReviewFolder(folder).apply(Decisions(surfaces=decided), MADE_NS, neighbourhood)


def test_the_nearest_changes_come_first_with_their_places_and_roads(folder: Path, capsys: Any) -> None:
    held_and_pending(folder)
    lines = output(capsys, "review", folder).splitlines()
    assert [line.split()[0] for line in lines] == ["surface", "2", str(2**61 + 3)]
    latitude, longitude = map(math.degrees, at(800.0, 0.0))
    assert lines[1].split()[1:5] == [f"{latitude:.6f}", f"{longitude:.6f}", "link", str(2**61 + 1)]
    near = (f"{math.degrees(value):.7f}" for value in at(2390.0, 0.0))
    lines = output(capsys, "review", folder, "--near", *near).splitlines()
    assert [line.split()[:3] for line in lines[1:]] == [["10", "m", str(2**61 + 3)], ["1590", "m", "2"]]
    geometry = {"type": "LineString", "coordinates": [[136.9, 35.1], [136.9, 35.2]]}
    road = {
        "type": "Feature",
        "geometry": geometry,
        "properties": {"link_id": str(2**61 + 1), "name": "Elm Street"},
    }
    (folder.parent / "roads.geojson").write_text(json.dumps({"features": [road]}))
    named = output(capsys, "review", folder, "--roads", folder.parent / "roads.geojson")
    assert named.count("Elm Street") == 2
    (_, pending) = output(capsys, "review", folder, "--pending").splitlines()
    assert pending.split()[0] == "5"
    assert pending.endswith("too few days")


def test_a_rejected_change_is_listed_and_can_be_accepted(folder: Path, capsys: Any) -> None:
    rows = np.zeros(1, DECISION)
    rows["surface_id"], rows["offset_m"], rows["decision"] = 4, 0.31, DECISIONS.index("hold")
    for action, listed in (("--reject", "held"), ("--accept", "rejected")):
        ReviewFolder(folder).apply(Decisions(surfaces=rows), MADE_NS)
        options = () if listed == "held" else (f"--{listed}",)
        assert "+0.310 m" in output(capsys, "review", folder, *options)
        output(capsys, "review", folder, action, 4, "--who", "ben", "--why", "seen on site")
    judged = ReviewFolder(folder).apply(Decisions(surfaces=rows), MADE_NS)
    assert judged.surfaces["decision"][0] == DECISIONS.index("publish")


def test_where_operators_have_keys_the_command_line_needs_one_of_them(folder: Path, capsys: Any) -> None:
    held_and_pending(folder)
    key, operators = folder.parent / "key", OperatorKeys(keys={key_id(KEY.public_key()): KEY.public_key()})
    ReviewFolder(folder, operators).publish_operators()
    (folder.parent / "other").write_bytes(
        OTHER_KEY.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    )
    accept = ("review", folder, "--accept", 2, "--who", "ann", "--why", "seen on site")
    back = (
        "releases",
        folder,
        "--roll-back",
        9,
        "--signing-key",
        key,
        "--reason",
        "a ferry",
        "--operator-key",
    )
    assert "signature" in output(capsys, *accept, code=2)
    assert "an operator's key" in output(capsys, *accept, "--operator-key", folder.parent / "other", code=2)
    assert "an operator's key" in output(capsys, *back, folder.parent / "other", code=2)
    assert ReviewFolder(folder).decisions() == []
    output(capsys, *accept, "--operator-key", key)
    output(capsys, *back, key)
    log = output(capsys, "review", folder, "--log").splitlines()
    assert [line[21:30].strip() for line in log] == ["accept", "roll_back"]
    assert f"key {key_id(KEY.public_key())}" in log[0]
    (folder / "review" / "operators.json").write_text("[]")
    assert "keys of operators" in output(capsys, *accept, "--operator-key", key, code=2)


def test_ids_in_geojson_keep_all_their_digits(folder: Path, capsys: Any) -> None:
    held_and_pending(folder)
    out = folder.parent / "held.geojson"
    output(capsys, "review", folder, "--geojson", out)
    features = json.loads(out.read_text())["features"]
    assert [feature["id"] for feature in features] == ["2", str(2**61 + 3)]
    assert features[1]["properties"]["link_id"] == str(2**61 + 1)
    longitude, latitude = features[1]["geometry"]["coordinates"]
    assert (math.radians(latitude), math.radians(longitude)) == pytest.approx(at(2400.0, 0.0), abs=1e-9)
    assert "a new file" in output(capsys, "review", folder, "--geojson", out, code=2)


def test_a_vehicle_goes_back_by_its_operator_only(folder: Path, capsys: Any) -> None:
    path = folder.parent / "map.sqlite"
    store = MapStore(path)
    fetching = ReleaseDownload(
        store, region="test", public_key=KEY.public_key(), around_m=None, now_ns=lambda: MADE_NS
    )
    cloud = Cloud(folder)
    builder = making(folder.parent)
    for step in (1, 2):
        fetching.ask(cloud)
        list(fetching.fetch(cloud))
        builder.build(offsets(s1=0.1 * step), time_ns=MADE_NS + 10 * step)
    lines = output(capsys, "releases", path).splitlines()
    assert [line.split()[0] for line in lines[:2]] == ["11", "10"]
    assert "version 10 is in force again" in output(capsys, "releases", path, "--go-back")
    assert open_release(store).root.map_version == 10
    assert "left by the operator" in output(capsys, "releases", path)
    assert "folder of releases" in output(capsys, "releases", path, "--why", 3, code=2)


@pytest.mark.parametrize("command", ["releases", "review"])
def test_what_is_not_there_is_one_line(tmp_path: Path, capsys: Any, command: str) -> None:
    assert output(capsys, command, tmp_path / "none", code=2).count("\n") == 1
