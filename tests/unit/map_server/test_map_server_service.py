"""The service answers from a valid release, follows the folder, and replies unknown otherwise."""

from __future__ import annotations

import hashlib
import random
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from camber.map_server.service import MapServerService
from camber.map_server.settings import MapServerSettings
from camber.road_map.release import ROOT_NAME
from camber.runtime.bus import Bus
from camber.runtime.settings import ConfigError, load
from camber.schemas.base import Message
from camber.schemas.fleet import ReleaseHead
from camber.schemas.pose import Road
from camber.schemas.road import (
    ElevationRequest,
    Layer,
    LinksReply,
    LinksRequest,
    Places,
    TileReply,
    TileRequest,
)
from support.fake_bus import FakeBus
from support.release_world import KEY, LINK
from support.small_map import DAY_NS, MADE_NS, TILE, at, surface, write


class Server:
    """A service on a fake bus, queried through its table of answers."""

    def __init__(self, folder: Path | None, **settings: Any) -> None:
        self.bus = FakeBus(MADE_NS + DAY_NS)
        self.service = MapServerService(MapServerSettings(release=folder, **settings), cast(Bus, self.bus))
        self.answers = self.service.answers()

    def wait(self, seconds: float, rounds: int = 4) -> None:
        for _ in range(rounds):
            self.bus.time_ns += int(seconds / rounds * 1e9)
            self.service.advance(self.bus.time_ns)

    def ask(self, channel: str, request: type[Message], **fields: Any) -> Any:
        (reply,) = self.answers[channel]([request(time_ns=self.bus.time_ns, **fields)])
        assert reply is not None
        assert reply.time_ns == self.bus.time_ns
        return reply

    def road(self, east_m: float = 0.0, north_m: float = 0.0, **fields: Any) -> Road:
        return cast(Road, self.ask("elevation", ElevationRequest, **place(east_m, north_m), **fields).road)

    def links(self) -> LinksReply:
        return cast(LinksReply, self.ask("links", LinksRequest, **place(), radius_m=50.0))

    def tile(self, layer: Layer = "surfaces", **fields: Any) -> TileReply:
        x, y = TILE
        return cast(TileReply, self.ask("tile", TileRequest, x=x, y=y, layer=layer, **fields))

    def assert_unknown(self, reason: str) -> None:
        assert self.road() == Road(status="unknown", reason=reason)
        assert (self.links().status, self.links().reason) == ("unknown", reason)
        assert (self.tile().status, self.tile().reason) == ("unknown", reason)
        assert not self.service.healthy()


def place(east_m: float = 0.0, north_m: float = 0.0) -> dict[str, float]:
    return dict(zip(("latitude_rad", "longitude_rad"), at(east_m, north_m), strict=True))


def served(folder: Path, **settings: Any) -> Server:
    """A server of a release of one surface and one link."""
    write(folder, [surface(5)], [LINK])
    return Server(folder, **settings)


def test_a_good_release_is_served(tmp_path: Path) -> None:
    server = served(tmp_path)
    assert server.road().elevation_m == pytest.approx(50.0)
    assert server.road(500.0).reason == "no_surface"
    assert server.links().link_id.tolist() == [1]
    reply = server.tile()
    assert hashlib.sha256(reply.payload.tobytes()).hexdigest() == reply.sha256
    assert server.tile(have_sha256=reply.sha256).status == "unchanged"
    assert server.tile("road_cloud").reason == "the release has no such tile"
    assert server.service.healthy()
    facts = server.service.facts()
    assert facts["map_release"].split()[1] == str(server.links().map_version)
    assert facts["datum"] == "WGS84"
    assert server.bus.issues == []
    assert server.bus.counters["elevation.known"] == 1
    assert server.bus.counters["elevation.no_surface"] == 1


def test_queries_of_one_group_are_answered_in_order(tmp_path: Path) -> None:
    write(tmp_path, [surface(5), surface(6, 100.0)])
    server = Server(tmp_path)
    requests = [ElevationRequest(time_ns=MADE_NS, **place(east_m)) for east_m in (100.0, 0.0)]
    replies = server.answers["elevation"](requests)
    assert [cast(Any, reply).road.surface_id for reply in replies] == [6, 5]


def test_places_ahead_are_answered_where_the_road_is_known(tmp_path: Path) -> None:
    write(tmp_path, [surface(5), surface(6, 20.0, heights_m=50.04)])
    server = Server(tmp_path)
    places = Places(east_m=np.array([20.0, 190.0, 1.0]), north_m=np.zeros(3))
    ahead = server.ask("elevation", ElevationRequest, **place(), ahead=places).ahead
    assert ahead.place.tolist() == [0, 2]
    assert ahead.surface_id.tolist() == [6, 5]
    assert ahead.elevation_m == pytest.approx([50.04, 50.0], abs=1e-4)
    far = server.ask("elevation", ElevationRequest, **place(0.0, 300.0), ahead=places)
    assert (far.road.status, far.ahead) == ("unknown", None)


def test_without_a_release_nothing_is_known_until_it_comes(tmp_path: Path) -> None:
    server = Server(tmp_path / "later")
    server.assert_unknown("map_missing")
    assert server.bus.codes() == {"release_refused"}
    write(tmp_path / "later", [surface(5)], [LINK])
    server.wait(3.0)
    assert server.road().status == "known"
    assert server.service.healthy()


def test_another_datum_makes_everything_unknown(tmp_path: Path) -> None:
    write(tmp_path, [surface(5)], [LINK], datum="JGD2011")
    server = Server(tmp_path)
    server.assert_unknown("datum_mismatch")
    text = f"{tmp_path / ROOT_NAME}: datum is 'JGD2011', expected WGS84"
    assert server.bus.issues == [("datum_mismatch", text)]
    assert Server(tmp_path, datum="JGD2011").road().datum == "JGD2011"
    # The mismatch is a state, not an event: it is still there at the next question and after the next look.
    server.wait(200.0, rounds=50)
    server.assert_unknown("datum_mismatch")


def test_a_release_of_another_datum_does_not_replace_a_good_one(tmp_path: Path) -> None:
    server = served(tmp_path)
    write(tmp_path, [surface(5)], datum="JGD2011", map_version=8)
    server.wait(3.0)
    assert server.road().map_version == 7
    assert not server.service.healthy()


def test_a_stale_release_is_unknown(tmp_path: Path) -> None:
    server = served(tmp_path, max_age_days=30.0)
    assert server.road().status == "known"
    server.bus.time_ns = MADE_NS + 30 * DAY_NS
    assert server.road().status == "known"
    server.bus.time_ns += 1
    server.assert_unknown("map_stale")
    server.wait(3.0)
    assert "map_stale" in server.bus.codes()


def test_a_release_from_the_future_is_stale(tmp_path: Path) -> None:
    server = served(tmp_path, max_age_days=30.0)
    server.bus.time_ns = MADE_NS - 2 * DAY_NS
    server.assert_unknown("map_stale")
    without_limit = Server(tmp_path)
    without_limit.bus.time_ns = MADE_NS - 2 * DAY_NS
    assert without_limit.road().status == "known"


def test_a_signature_is_required_where_a_key_is_set(tmp_path: Path) -> None:
    key = tmp_path / "release.pub"
    key.write_bytes(KEY.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    write(tmp_path / "signed", [surface(5)], [LINK], signing_key=KEY)
    assert Server(tmp_path / "signed", public_key=key).road().status == "known"
    served(tmp_path / "unsigned", public_key=key).assert_unknown("map_missing")


def test_an_unreadable_key_prevents_the_start(tmp_path: Path) -> None:
    arguments = ["--release", str(tmp_path), "--public-key", str(tmp_path / "missing.pub")]
    with pytest.raises(ConfigError, match=r"public_key: .*missing\.pub: public key, expected an Ed25519 key"):
        load(MapServerSettings, arguments, prog="camber map_server")


def test_a_new_release_is_verified_while_the_old_one_answers(tmp_path: Path) -> None:
    server = served(tmp_path, verify_bytes=1)
    write(tmp_path, [surface(5 + i, 700.0 * i, heights_m=51.0) for i in range(5)], map_version=8)
    server.wait(1.0)
    assert server.road().map_version == 7
    seen = []
    for _ in range(12):
        server.wait(1.5, rounds=1)
        seen.append((server.road().map_version, server.road().elevation_m))
    assert seen == sorted(seen)
    assert set(seen) == {(7, 50.0), (8, 51.0)}
    assert server.service.healthy()


@pytest.mark.parametrize(
    ("changed", "field"),
    [
        ({"map_version": 3}, "map_version"),
        ({"map_version": 9, "region": "elsewhere"}, "region"),
        ({"map_version": 7}, "manifest_sha256"),
    ],
)
def test_no_older_release_and_none_of_another_region_takes_the_place_of_one(
    changed: dict[str, Any], field: str, tmp_path: Path
) -> None:
    state = tmp_path / "state"
    server = served(tmp_path / "map", state_dir=state)
    write(tmp_path / "map", [surface(5, heights_m=51.0)], **changed)
    server.wait(3.0)
    assert server.road().elevation_m == 50.0
    assert field in server.bus.text("release_refused")
    again = Server(tmp_path / "map", state_dir=state)
    again.assert_unknown("map_missing")
    assert field in again.bus.text("release_refused")
    (state / "release.json").unlink()
    assert Server(tmp_path / "map", state_dir=state).road().elevation_m == 51.0


def test_an_invalid_new_release_leaves_the_old_one_and_is_retried(tmp_path: Path) -> None:
    server = served(tmp_path)
    before = set(tmp_path.rglob("*"))
    manifest = write(tmp_path, [surface(5, heights_m=51.0)], map_version=8).manifest_sha256
    new = [path for path in set(tmp_path.rglob("*")) - before if path.is_file() and path.name != manifest]
    late = {path: path.read_bytes() for path in new}
    for path in late:
        path.unlink()
    server.wait(3.0)
    assert server.road().map_version == 7
    assert not server.service.healthy()
    assert "release_refused" in server.bus.codes()
    for path, data in late.items():
        path.write_bytes(data)
    server.wait(70.0, rounds=40)
    assert server.road().map_version == 8
    assert server.service.healthy()


def test_a_clock_set_back_does_not_stop_the_checks(tmp_path: Path) -> None:
    server = Server(tmp_path)
    write(tmp_path, [surface(5)])
    server.bus.time_ns -= DAY_NS
    server.service.advance(server.bus.time_ns)
    assert server.road().status == "known"


def test_a_tile_that_is_damaged_under_the_service_is_unknown(tmp_path: Path) -> None:
    server = served(tmp_path)
    for path in (tmp_path / "blobs").glob("*/*"):
        path.write_bytes(path.read_bytes()[:-1] + b"\x7f")
    server.assert_unknown("map_missing")
    assert server.bus.codes() == {"tile_unreadable"}


@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_release_never_makes_a_road_known_from_altered_data(tmp_path: Path, seed: int) -> None:
    write(tmp_path, [surface(5), surface(6, 0.0, 0.0, link_id=2, level=1, heights_m=56.0)], [LINK])
    topologies = [{"link_ids": (1,)}, {"link_ids": (2,)}, {}, {"last_surface_id": 5}]
    good_server = Server(tmp_path)
    want = [good_server.road(**topology) for topology in topologies]
    assert [answer.status for answer in want] == ["known", "known", "unknown", "known"]
    files = sorted(p for p in tmp_path.rglob("*") if p.is_file())
    rng = random.Random(seed)
    for _ in range(120):
        path = rng.choice(files)
        good = path.read_bytes()
        bad = bytearray(good)
        bad[rng.randrange(len(bad))] ^= 1 << rng.randrange(8)
        path.write_bytes(bad if rng.random() < 0.8 else bad[: rng.randrange(len(bad))])
        server = Server(tmp_path)
        for topology, road in zip(topologies, want, strict=True):
            assert server.road(**topology) in (road, Road(status="unknown", reason="map_missing"))
        path.write_bytes(good)


def test_a_surrogate_map_is_reported(tmp_path: Path) -> None:
    write(tmp_path, [surface(5)], surrogate="made from the drive's truth, sigma 0.05 m")
    assert ("surrogate_map", "made from the drive's truth, sigma 0.05 m") in Server(tmp_path).bus.issues


def test_a_newer_release_elsewhere_is_reported(tmp_path: Path) -> None:
    server = served(tmp_path)
    on_release = server.service.handlers()["release"]
    for version, region in ((7, "test"), (6, "test"), (8, "test")):
        assert "release_behind" not in server.bus.codes()
        on_release(ReleaseHead(time_ns=MADE_NS, region=region, map_version=version, manifest_sha256="0" * 64))
    assert "release_behind" in server.bus.codes()


def test_without_its_root_a_release_still_answers_but_is_unhealthy(tmp_path: Path) -> None:
    server = served(tmp_path)
    (tmp_path / ROOT_NAME).unlink()
    server.wait(3.0)
    assert server.road().status == "known"
    assert not server.service.healthy()


def test_the_page_names_every_setting_and_every_reason() -> None:
    page = (Path(__file__).parents[3] / "docs/services/map_server.md").read_text("utf-8")
    names = set(MapServerSettings.model_fields) - set(MapServerSettings.__mro__[1].model_fields)  # type: ignore[attr-defined]
    reasons = {"no_surface", "levels_ambiguous", "map_stale", "map_missing", "datum_mismatch"}
    assert {name for name in names | reasons if f"`{name}`" not in page} == set()


@pytest.mark.parametrize("release", [True, False])
def test_where_the_store_cannot_be_used_the_release_is_served(tmp_path: Path, release: bool) -> None:
    write(tmp_path / "map", [surface(5)])
    (tmp_path / "store.sqlite").mkdir()  # no file can be opened there
    server = Server(tmp_path / "map" if release else None, store=tmp_path / "store.sqlite")
    assert "store_unusable" in server.bus.codes()
    assert not server.service.healthy()
    server.wait(10.0)
    if release:
        assert server.road().status == "known"
    else:
        server.assert_unknown("map_missing")
    server.service.close()
