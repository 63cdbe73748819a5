"""Access rules follow the table of channels: default deny, own names only, and what is in deploy/ is what is made."""

from __future__ import annotations

import json
import re
import shlex
import stat
from fnmatch import fnmatchcase
from itertools import product
from pathlib import Path

import pytest

from camber.runtime.session import OUTSIDE
from camber.schemas.channels import BY_NAME, CHANNELS
from camber.tools.security import access
from camber.tools.security.access_rules import (
    AllowedMessage,
    Party,
    allowed_messages,
    cloud_access_control,
    open_channels,
    vehicle_access_control,
)
from support.refusals import Refused
from support.tree import ROOT

ALL = ("vehicle", "map_update", "consumer", "judge", "operator")
SAYS = {"put", "query", "declare_queryable", "reply"}
FILES = sorted((ROOT / "deploy/zenoh").glob("*.json5"))


def keys(rules: list[AllowedMessage], flow: str, *messages: str) -> set[str]:
    return {rule.key for rule in rules if rule.flow == flow and rule.message in messages}


def text_without_comments(path: Path) -> str:
    return "\n".join(line for line in path.read_text().splitlines() if not line.startswith("//"))


def test_nothing_is_allowed_that_is_not_listed() -> None:
    for control in (cloud_access_control([], ["cloud"]), vehicle_access_control("v", ["map_update"])):
        assert control["enabled"] is True
        assert control["default_permission"] == "deny"
        assert {rule["permission"] for rule in control["rules"]} == {"allow"}


def test_every_rule_is_someones_and_every_subject_has_a_certificate_or_a_link() -> None:
    control = cloud_access_control([Party(kind=kind, name=f"my-{kind}") for kind in ALL], ["cloud"])
    ids = [rule["id"] for rule in control["rules"]]
    assert len(ids) == len(set(ids))
    assert sorted(i for policy in control["policies"] for i in policy["rules"]) == sorted(ids)
    assert all(subject["cert_common_names"] for subject in control["subjects"])
    # A subject without any condition would be everybody.
    inside, outside = vehicle_access_control("v", ["map_update"])["subjects"]
    assert set(outside["link_protocols"]) == set(OUTSIDE)
    assert not set(inside["link_protocols"]) & set(OUTSIDE)


def test_no_name_of_a_party_makes_an_id_that_is_there_already() -> None:
    parties = [
        Party(kind="consumer", name="routers"),
        Party(kind="vehicle", name="c", common_name="routers 1"),
        Party(kind="judge", name="vehicle"),
        Party(kind="vehicle", name="a"),
        Party(kind="operator", name="b", common_name="vehicle a"),
        Party(kind="consumer", name="d", common_name="a 1"),
    ]
    control = cloud_access_control(parties, ["cloud"])
    for table in ("rules", "subjects"):
        ids = [row["id"] for row in control[table]]
        assert len(ids) == len(set(ids)), table


@pytest.mark.parametrize("others", [("map_update", "consumer"), ALL])
def test_a_vehicle_publishes_only_under_its_name(others: tuple[str, ...]) -> None:
    for rule in allowed_messages(Party(kind="vehicle", name="car-1"), others):
        if rule.flow == "ingress" and rule.message in {*SAYS, "liveliness_token"}:
            is_under_its_name = rule.key.startswith(("camber/v1/car-1/", "camber/v1/fleet/car-1/"))
            asks_for_the_map = rule.message == "query" and rule.key.startswith("camber/v1/fleet/map/")
            assert is_under_its_name or asks_for_the_map, rule
        assert rule.message != "delete"


def test_nothing_of_one_vehicle_goes_to_another() -> None:
    first, second = (allowed_messages(Party(kind="vehicle", name=name), ALL) for name in ("car-1", "car-2"))
    out = keys(first, "ingress", "put", "reply", "liveliness_token")
    into = keys(second, "egress", "put", "reply", "liveliness_token")
    assert out
    assert into
    assert not [(a, b) for a, b in product(out, into) if fnmatchcase(a, b) or fnmatchcase(b, a)]


def test_only_map_update_publishes_releases_and_answers_for_the_fleet() -> None:
    of_fleet = {"release", "map_root", "map_blob", "upload", "upload_batch"}
    for kind in ALL:
        rules = allowed_messages(Party(kind=kind, name="car-1"), ALL)
        output = keys(rules, "ingress", "put", "reply", "declare_queryable")
        wanted = {BY_NAME[name].answered_at("car-1") for name in of_fleet}
        assert bool(output & wanted) == (kind == "map_update"), kind


def test_consumers_receive_only_verdicts_and_positions() -> None:
    rules = allowed_messages(Party(kind="consumer", name="dashboard"), ALL)
    assert keys(rules, "ingress", *SAYS) == {"camber/v1/dashboard/echo"}
    assert keys(rules, "ingress", "declare_subscriber") == {
        "camber/v1/*/integrity/verdict",
        "camber/v1/*/integrity/position",
        "camber/v1/dashboard/echo",
    }


def test_sweeps_tiles_and_replays_cross_for_nobody() -> None:
    crossing = {channel.name for channel, _, _ in open_channels(ALL)}
    assert not crossing & {"sweep", "tile", "elevation", "links", "tick", "done", "receiver_bytes"}


def test_without_a_judge_in_the_cloud_its_inputs_stay_in_the_vehicle() -> None:
    crossing = {channel.name for channel, _, _ in open_channels(("vehicle", "map_update", "consumer"))}
    of_vehicle = {channel.name for channel in CHANNELS if channel.key.startswith("camber/v1/{vehicle}/")}
    # Health and log level are those of map_update itself.
    assert crossing & of_vehicle == {"verdict", "position", "health", "log_level"}
    rules = allowed_messages(Party(kind="vehicle", name="car-1"), ("map_update", "consumer"))
    assert keys(rules, "ingress", "put") == {
        "camber/v1/car-1/integrity/verdict",
        "camber/v1/car-1/integrity/position",
        "camber/v1/car-1/echo",
    }
    assert keys(rules, "ingress", "reply") == set()


def test_the_vehicle_s_router_mirrors_the_rules_of_the_cloud_s() -> None:
    control = vehicle_access_control("car-1", ["map_update", "consumer"])
    (ids,) = [policy["rules"] for policy in control["policies"] if policy["subjects"] == ["cloud"]]
    mirrored = {
        (flow, message, key)
        for rule in control["rules"]
        if rule["id"] in ids
        for flow, message, key in product(rule["flows"], rule["messages"], rule["key_exprs"])
    }
    turned = {"ingress": "egress", "egress": "ingress"}
    clouds = allowed_messages(Party(kind="vehicle", name="car-1"), ["map_update", "consumer"])
    assert mirrored == {(turned[rule.flow], rule.message, rule.key) for rule in clouds}


@pytest.mark.parametrize(
    "parties",
    [
        [Party(kind="vehicle", name="car-1"), Party(kind="consumer", name="car-1")],
        [Party(kind="vehicle", name=name, common_name="x") for name in ("car-1", "car-2")],
        [Party(kind="consumer", name="cloud")],
    ],
    ids=["one name", "one certificate", "the router's"],
)
def test_two_parties_never_share_a_name(parties: list[Party]) -> None:
    with pytest.raises(ValueError, match="stands for more than one party"):
        cloud_access_control(parties, ["cloud"])


def test_the_files_of_deploy_are_there() -> None:
    assert {path.name for path in FILES} == {"cloud.json5", "vehicle.json5"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_file_of_deploy_is_what_its_command_makes(path: Path, tmp_path: Path) -> None:
    (command,) = re.findall(r"^// Made by `camber access (.*)`", path.read_text(), re.MULTILINE)
    assert access.main([*shlex.split(command), "--out", str(tmp_path / path.name)]) == 0
    assert (tmp_path / path.name).read_text() == path.read_text(), f"make it anew: camber access {command}"
    assert json.loads(text_without_comments(path))["access_control"]["default_permission"] == "deny"


@pytest.mark.parametrize("name", ["fleet", "car/1", "*", "car-1+2", ""])
def test_a_name_that_would_be_something_else_in_a_key_is_refused(name: str, refused: Refused) -> None:
    refused(access.main, "vehicle", name, "--connect", "tls/c:1")


@pytest.mark.parametrize(
    ("option", "expected", "endpoint"),
    [
        # Over anything else the cloud would be a service within.
        *(
            ("--connect", "tls/… or quic/…", endpoint)
            for endpoint in ("tcp/c:1", "unixsock-stream//c", "ws/c:1")
        ),
        # Over these a service within would be the cloud.
        *(
            ("--listen", "tcp/… or unixsock-stream/…", f"{name}/0.0.0.0:7447")
            for name in ("tls", "quic", "ws")
        ),
    ],
)
def test_the_cloud_is_joined_over_tls_alone_and_nobody_within_is_taken_for_it(
    option: str, expected: str, endpoint: str, refused: Refused
) -> None:
    arguments = ["vehicle", "car-1", "--connect", "tls/c:1", "--listen", "tcp/127.0.0.1:7447"]
    assert access.main(arguments) == 0
    line = refused(access.main, *arguments, option, endpoint)
    assert line == f"camber access: {option} {endpoint}: expected {expected}"


def test_a_file_is_written_where_it_stands_with_the_mode_that_it_has(tmp_path: Path) -> None:
    arguments = ["vehicle", "car-1", "--connect", "tls/c:1", "--out", str(tmp_path / "link.json5")]
    (tmp_path / "there").mkdir()
    target = tmp_path / "there" / "vehicle.json5"
    target.write_text("// Made by `camber access vehicle car-1`\n")
    target.chmod(0o640)
    (tmp_path / "link.json5").symlink_to(target)
    assert access.main(arguments) == 0
    assert (tmp_path / "link.json5").is_symlink()
    assert "access_control" in target.read_text()
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert list((tmp_path / "there").iterdir()) == [target]


def test_where_a_file_cannot_be_written_nothing_is_left(tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "folder").mkdir()
    refused(access.main, "vehicle", "car-1", "--connect", "tls/c:1", "--out", tmp_path / "folder")
    assert list(tmp_path.iterdir()) == [tmp_path / "folder"]
