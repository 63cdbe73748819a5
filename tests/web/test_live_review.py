"""The operator's path: a held change found on the map of the live page, looked at, accepted, published and driven over.

And requests to decide that are refused: without the page's token, from another origin, without a reason, on a change
that was decided on, and signed with a key that is no operator's.
"""

from __future__ import annotations

import json
import re
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from websockets.sync.client import connect

from camber.map_update.fusion.publication_decision import DECISION, DECISIONS, Decisions
from camber.map_update.release.review import ReviewFolder
from camber.replay.short_drive import write_short_drive
from camber.road_map.operator_keys import load_operator_keys
from camber.road_map.release import load_signing_key, read_release
from camber.road_map.store import MapStore
from support.browser import chromium, served_address, watched
from support.changed_road import batches_in, confirmed_there, replay, survey, upload
from support.release_world import KEY, OTHER_KEY, public_pem, write_signing_keys
from support.running import CLOCK, camber, camber_started, loopback_router, settings_file, wait_until
from support.small_map import surface, write

pytestmark = pytest.mark.slow

DAYS_AGO = (9, 9, 9, 7, 5)
"""When each of the vehicles drove."""
TOKEN = "0123456789abcdef"


def write_operator(folder: Path, key: Any = KEY) -> tuple[Path, Path]:
    """An operator's key, and the folder with the public keys of all."""
    (folder / "operators").mkdir()
    (folder / "operators" / "ann.pub").write_bytes(public_pem(KEY))
    path = folder / "ann.key"
    path.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return path, folder / "operators"


def corrected(folder: Path) -> set[int]:
    """Surfaces whose heights in the vehicle's map are not the survey's."""
    path = folder / "vehicle.sqlite"
    if not path.exists():
        return set()
    with closing(MapStore(path)) as store:
        current = store.current()
        if current is None:
            return set()
        new = store.open(current.map_version).road_surfaces()
    old = read_release(folder / "survey").road_surfaces()
    moved = [abs((a - b).mean()) > 0.0 for a, b in zip(new.heights_m, old.heights_m, strict=True)]
    return set(old.surface_id[moved].tolist())


@contextmanager
def cloud(folder: Path, operators: Path) -> Iterator[str]:
    """A router, a map_update that holds changes of more than 20 cm, a vehicle's map_server; where the router is."""
    key, public = folder / "release.key", folder / "release.pub"
    with loopback_router() as endpoint, (folder / "log").open("w") as log:
        config = "--config", settings_file(folder / "bus.toml", endpoint, vehicle="car9")
        fusing = (
            "--reference",
            folder / "survey",
            "--signing-key",
            key,
            "--fuse-every-s",
            0.5,
            "--street-m",
            60.0,
        )
        deciding = "--publish-largest-m", 0.2, "--operator-keys", operators
        vehicle = "--release", folder / "survey", "--public-key", public, "--store", folder / "vehicle.sqlite"
        with (
            camber_started(
                "map_update", *config, "--state-dir", folder / "cloud", *fusing, *deciding, stdout=log
            ),
            camber_started("map_server", *config, *vehicle, "--ask-every-s", 0.5, stdout=log),
        ):
            wait_until(
                (folder / "cloud/releases/root.msgpack").exists, timeout_s=60.0, why="no first release"
            )
            yield endpoint


def test_an_operator_accepts_what_is_held_and_the_next_vehicle_confirms_there(tmp_path: Path) -> None:
    key, _ = write_signing_keys(tmp_path, tmp_path)
    operator, operators = write_operator(tmp_path)
    write_short_drive(tmp_path / "now")
    _, changed = survey(tmp_path, tmp_path / "now/map", load_signing_key(key))
    outs = [replay(tmp_path, vehicle, ago, "survey") for vehicle, ago in enumerate(DAYS_AGO)]
    for confirmed, total in map(confirmed_there, outs):
        assert confirmed < 0.5 * total
    with chromium() as browser, ExitStack() as ends:
        endpoint = ends.enter_context(cloud(tmp_path, operators))
        for out in outs:
            for batch in batches_in(out):
                upload(endpoint, batch)
        command = "live", "--fleet", "--connect", endpoint, "--port", 0, "--map", tmp_path / "survey"
        process = ends.enter_context(camber_started(*command, "--review", operator))
        shown = watched(browser, served_address(process) + "#theme=light")
        page = shown.page
        surfaces = [str(surface_id) for surface_id in changed.tolist()]
        are_held = f"{surfaces}.every(id => camber.store.changes.held.some(row => row.surface_id === id))"
        shown.wait_for(f"camber.map.ready && camber.store.changes && {are_held}", timeout_s=90.0)
        accept_on_the_map(shown, surfaces[0])
        for surface_id in surfaces[1:]:
            page.get_by_role("button", name=re.compile(rf"surface {surface_id}$")).click()
            accept(page, "the road was resurfaced, photo of the site")
        published = (
            f"{surfaces}.every(id => camber.store.changes.published.some(row => row.surface_id === id))"
        )
        shown.wait_for(published)
        wait_until(
            lambda: corrected(tmp_path) >= set(changed.tolist()),
            timeout_s=60.0,
            why="no new release in the vehicle",
        )
        assert (shown.complaints, shown.elsewhere()) == ([], [])
        page.close()
    record = ReviewFolder(tmp_path / "cloud/releases").decisions()
    assert {each.surface_id for each in record} == set(changed.tolist())
    for each in record:
        load_operator_keys(operators).check(each)
        assert (each.action, each.who) == ("accept", "Ann")
    confirmed, total = confirmed_there(replay(tmp_path, 9, 1, "cloud/releases"))
    print(f"confirmed at once where the road has changed: {confirmed} of {total}")
    assert confirmed >= 0.99 * total


def accept_on_the_map(shown: Any, surface_id: str) -> None:
    """Click the mark of a held change, read what is known of it, and accept it with the keyboard."""
    page = shown.page
    row = f"camber.store.changes.held.find(row => row.surface_id === '{surface_id}')"
    page.evaluate(
        f"camber.map.setFollow(false); camber.map.map.jumpTo({{center: [{row}.lon, {row}.lat], zoom: 19}})"
    )
    box = page.locator("camber-map .canvas").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    chosen = page.locator("camber-changes section.chosen")
    chosen.wait_for()
    shown.wait_for("document.querySelectorAll('.votes circle').length === 1")
    text = chosen.text_content()
    assert f"surface{surface_id}" in text
    assert f"{len(DAYS_AGO)} vehicles" in text
    assert "larger than is published unseen" in text
    accept(page, "measured on site", by_keys=True)


def accept(page: Any, why: str, *, by_keys: bool = False) -> None:
    """Accept the change that is looked at."""
    button = page.locator("[data-action=accept]")
    if by_keys:
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.dataset.action") == "accept"
        page.keyboard.press("Enter")
        page.keyboard.type("Ann")
        page.keyboard.press("Tab")
        page.keyboard.type(why)
    else:
        button.click()
        page.get_by_label("Why").fill(why)
    if by_keys:
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
    else:
        page.locator("dialog.decision button[type=submit]").click()
    page.locator("dialog.decision").wait_for(state="detached")
    assert "Accepted" in page.locator("camber-changes [role=status]").text_content()


@contextmanager
def small_cloud(folder: Path, operator: Path, operators: Path) -> Iterator[tuple[str, str]]:
    """A map_update with a change that is held, and the page; its address and the review token."""
    write(folder / "survey", [surface(4)])
    with loopback_router() as endpoint, (folder / "log").open("w") as log:
        config = "--config", settings_file(folder / "bus.toml", endpoint, vehicle="car9")
        fusing = "--reference", folder / "survey", "--fuse-every-s", 3600, "--operator-keys", operators
        live = "live", "--fleet", "--connect", endpoint, "--port", 0, "--token", TOKEN, "--review", operator
        with (
            camber_started("map_update", *config, "--state-dir", folder / "cloud", *fusing, stdout=log),
            camber_started(*live) as process,
        ):
            wait_until(
                (folder / "cloud/releases/root.msgpack").exists, timeout_s=60.0, why="no first release"
            )
            wait_until(
                (folder / "cloud/releases/review/held.json").exists, timeout_s=60.0, why="nothing was decided"
            )
            rows = np.zeros(1, DECISION)
            rows["surface_id"], rows["offset_m"], rows["decision"] = 4, 0.31, DECISIONS.index("hold")
            ReviewFolder(folder / "cloud/releases").apply(Decisions(surfaces=rows), CLOCK.now_ns())
            address = served_address(process).partition("/?")[0]
            REFERENCE["reference_sha256"] = read_release(folder / "survey").root.manifest_sha256
            cookie = {"Cookie": f"camber_live={TOKEN}"}
            with connect(address.replace("http", "ws") + "/stream", additional_headers=cookie) as stream:
                yield address, json.loads(stream.recv(20.0))["review"]


def post(address: str, body: dict[str, Any] | bytes, **headers: str | None) -> tuple[int, str]:
    """Status code and reason of a request to decide; a header of None is left out."""
    data = body if isinstance(body, bytes) else json.dumps(REFERENCE | body).encode()
    request = urllib.request.Request(f"{address}/decision", data, method="POST")
    given = {"cookie": f"camber_live={TOKEN}", "origin": address} | headers
    for name, value in given.items():
        if value is not None:
            request.add_header(name.replace("_", "-"), value)
    try:
        with urllib.request.urlopen(request, timeout=20.0) as reply:
            return reply.status, ""
    except urllib.error.HTTPError as error:
        text = error.read().decode()
        return error.code, text


REFERENCE: dict[str, Any] = {}
"""What a decision says of the map, once there is one."""
ACCEPT = {"action": "accept", "surface_id": "4", "offset_m": 0.31, "who": "Ann", "why": "seen on site"}


def test_requests_that_are_not_the_operators_are_refused(tmp_path: Path) -> None:
    operator, operators = write_operator(tmp_path)
    with small_cloud(tmp_path, operator, operators) as (address, token):
        for headers, code in (
            ({"x_camber_review": None}, 403),
            ({"x_camber_review": "x" * len(token)}, 403),
            ({"x_camber_review": token, "origin": "http://example.org"}, 403),
            ({"x_camber_review": token, "origin": "null"}, 403),
            ({"x_camber_review": token, "origin": None}, 403),
            ({"x_camber_review": token, "cookie": None}, 403),
        ):
            assert post(address, ACCEPT, **headers)[0] == code, headers
        for changed, reason in (
            ({"why": ""}, "why"),
            ({"why": "  "}, "why"),
            ({"who": ""}, "who"),
            ({"surface_id": "x"}, "not a decision"),
            ({"action": "publish"}, "action"),
            ({"signature": "00"}, "not a decision"),
            ({"who": "Ann\x1b[2J"}, "printable"),
            ({"map_version": "8"}, "accept without map_version"),
            ({"offset_m": 10**400}, "not a decision"),
        ):
            code, text = post(address, ACCEPT | changed, x_camber_review=token)
            assert (code, reason in text) == (400, True), (changed, text)
        assert post(address, b"[" * 4000, x_camber_review=token)[0] == 400
        assert post(address, b" " * 5000, x_camber_review=token)[0] == 413
        review = ReviewFolder(tmp_path / "cloud/releases")
        assert review.decisions() == []
        code, text = post(address, ACCEPT | {"reference_sha256": "0" * 64}, x_camber_review=token)
        assert (code, "another reference" in text) == (409, True), text
        code, text = post(address, ACCEPT | {"offset_m": 0.2}, x_camber_review=token)
        assert (code, "the votes give now" in text) == (409, True), text
        assert post(address, ACCEPT, x_camber_review=token) == (200, "")
        assert [(each.who, each.why) for each in review.decisions()] == [("Ann", "seen on site")]
        back = {"action": "roll_back", "map_version": "8", "who": "Ann", "why": "a ferry was mapped"}
        code, text = post(address, back | {"map_version": "77"}, x_camber_review=token)
        assert (code, "one of 8, 7" in text) == (409, True), text
        assert post(address, back, x_camber_review=token) == (200, "")
        assert [(each.action, each.map_version) for each in review.decisions()][1:] == [("roll_back", 8)]
        for again in (ACCEPT, ACCEPT | {"action": "reject"}):
            code, text = post(address, again, x_camber_review=token)
            assert (code, "decided already: accept by Ann" in text) == (409, True), text


def test_a_key_that_is_no_operators_decides_nothing(tmp_path: Path) -> None:
    operator, operators = write_operator(tmp_path, OTHER_KEY)
    with small_cloud(tmp_path, operator, operators) as (address, token):
        code, text = post(address, ACCEPT, x_camber_review=token)
        assert (code, "an operator's key" in text) == (409, True), text
        assert ReviewFolder(tmp_path / "cloud/releases").decisions() == []


def test_without_review_nothing_can_be_decided_and_beyond_loopback_it_needs_tls(tmp_path: Path) -> None:
    operator, _ = write_operator(tmp_path)
    with loopback_router() as endpoint:
        with camber_started("live", "--fleet", "--connect", endpoint, "--port", 0) as process:
            address = served_address(process).rstrip("/")
            with connect(address.replace("http", "ws") + "/stream") as stream:
                assert json.loads(stream.recv(20.0))["review"] is None
            assert post(address, ACCEPT, x_camber_review="")[0] == 403
        far = camber("live", "--fleet", "--host", "0.0.0.0", "--token", TOKEN, "--review", operator)
        assert (far.returncode, "for TLS" in far.stderr) == (2, True)
    alone = camber("live", "--review", operator)
    assert (alone.returncode, "--fleet" in alone.stderr) == (2, True)
