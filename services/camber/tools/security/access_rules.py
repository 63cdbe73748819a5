"""Zenoh access-control rules, derived from the table of channels and a list of parties.

Default deny. A party is a certificate's common name with its kind. A channel is open between two kinds where the table
lists one as producer and the other as consumer, so channels internal to a vehicle stay internal, and no rule names two
vehicles. The rules are those of the cloud's router; a vehicle's router applies the mirrored rules on its uplink, so
neither side has to trust the other's file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

from camber.runtime.access_probe import echo_key
from camber.runtime.session import OUTSIDE
from camber.schemas.channels import CHANNELS, SENSORS, VEHICLE_SERVICES, Channel

Kind = Literal["vehicle", "map_update", "consumer", "judge", "operator"]
Flow = Literal["ingress", "egress"]
Rule = dict[str, list[str]]
FLEET = "fleet"
"""Vehicle name in the keys of cloud services."""
INSIDE = ("tcp", "unixsock-stream")
MESSAGES = (
    "put", "delete", "declare_subscriber", "query", "reply", "declare_queryable", "liveliness_token",
    "liveliness_query", "declare_liveliness_subscriber",
)  # fmt: skip
ALIVE = "camber/v1/{vehicle}/{service}/alive"

_WITHIN = (*VEHICLE_SERVICES, SENSORS)
_ROLES: dict[Kind, frozenset[str]] = {
    "vehicle": frozenset({"vehicle", *_WITHIN}),
    "map_update": frozenset({"map_update"}),
    "consumer": frozenset({"consumers"}),
    "judge": frozenset({"integrity"}),
    "operator": frozenset({"tools"}),
}
_SERVICE: dict[Kind, str] = {"map_update": "map_update", "judge": "integrity"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Party:
    """A certificate holder; `name` is the vehicle's name, or the common name itself."""

    kind: Kind
    name: str
    common_name: str = ""

    @property
    def certificate(self) -> str:
        """The certificate's common name."""
        return self.common_name or self.name


@dataclass(frozen=True, slots=True, kw_only=True)
class AllowedMessage:
    """One Zenoh message type on a key that may pass the cloud's router, to (egress) or from (ingress) a party."""

    flow: Flow
    message: str
    key: str


def open_channels(kinds: Iterable[Kind]) -> Iterator[tuple[Channel, Kind, Kind]]:
    """Yield each channel with a kind that sends (publishes, queries) and one that receives (subscribes, replies)."""
    present = [kind for kind in _ROLES if kind in set(kinds)]
    for channel, sender, receiver in product(CHANNELS, present, present):
        if channel.delivery != "barrier" and _sends(channel, sender) and _receives(channel, receiver, sender):
            yield channel, sender, receiver


def _sends(channel: Channel, kind: Kind) -> bool:
    # `camber upload` runs in the vehicle, with the vehicle's certificate: tools need no right of their own.
    if channel.delivery == "upload" and "tools" in channel.producers:
        return kind == "vehicle"
    # The container health check queries map_update with map_update's certificate.
    return bool(_ROLES[kind] & set(channel.producers)) or (kind == "map_update" and _is_per_service(channel))


def _receives(channel: Channel, kind: Kind, sender: Kind) -> bool:
    if sender == kind:
        return kind == "map_update" and _is_per_service(channel)
    if sender == "map_update" and _is_per_service(channel):
        return False
    return bool(_ROLES[kind] & set(channel.consumers))


def _is_per_service(channel: Channel) -> bool:
    return "{service}" in channel.key


def allowed_messages(party: Party, kinds: Iterable[Kind]) -> list[AllowedMessage]:
    """Return all that the cloud's router lets pass from and to one party, where parties of `kinds` exist."""
    kinds = set(kinds) | {party.kind}
    messages: dict[AllowedMessage, None] = {}

    def add(flow: Flow, message: str, *keys: str) -> None:
        messages.update(dict.fromkeys(AllowedMessage(flow=flow, message=message, key=key) for key in keys))

    for channel, sender, receiver in open_channels(kinds):
        keys, wildcard_keys = _keys(channel, party, sender, receiver)
        is_query = channel.reply is not None
        send, declare = ("query", "declare_queryable") if is_query else ("put", "declare_subscriber")
        if sender == party.kind:
            add("ingress", send, *keys)
            # A receiver may subscribe to all vehicles at once, and its declaration then carries the wildcard.
            add("egress", declare, *keys, *wildcard_keys)
            if is_query:
                add("egress", "reply", *keys)
        if receiver == party.kind:
            add("ingress", declare, *keys)
            add("egress", send, *keys)
            if is_query:
                add("ingress", "reply", *keys)
    for flow, message, key in _liveliness(party, kinds):
        add(flow, message, key)
    for message in ("put", "declare_subscriber"):
        add("ingress", message, _echo(party))
        add("egress", message, _echo(party))
    return list(messages)


def _echo(party: Party) -> str:
    """Return the key on which this party receives its own probe; a judge may publish as any vehicle."""
    return echo_key({"judge": "*", "map_update": FLEET}.get(party.kind, party.name))


def _keys(channel: Channel, party: Party, sender: Kind, receiver: Kind) -> tuple[list[str], list[str]]:
    """Return the party's keys of a channel, and the wildcard keys under which others may declare them."""
    # Cloud services use the fleet's name in keys; a judge in the cloud uses that of each vehicle.
    in_fleet = receiver == "map_update" and "{service}" in channel.key
    service = _SERVICE.get(receiver, "*")
    wildcard = channel.key_for(FLEET if in_fleet else "*").replace("{service}", service)
    if party.kind != "vehicle" or in_fleet:
        return [wildcard], []
    key = channel.key_for(party.name)
    if "{service}" not in key:
        return [key], [wildcard]
    return [key.replace("{service}", name) for name in _WITHIN], [wildcard]


def _liveliness(party: Party, kinds: set[Kind]) -> Iterator[tuple[Flow, str, str]]:
    """Yield the liveliness messages allowed: only a judge in the cloud and operators may watch liveliness."""
    watched = {"judge", "operator"} & kinds
    every = ALIVE.format(vehicle="*", service="*")
    if party.kind == "vehicle" and watched:
        for service in _WITHIN:
            yield "ingress", "liveliness_token", ALIVE.format(vehicle=party.name, service=service)
        for key in (every, ALIVE.format(vehicle=party.name, service="*")):
            yield "egress", "liveliness_query", key
            yield "egress", "declare_liveliness_subscriber", key
        if "judge" in watched:
            yield "ingress", "declare_liveliness_subscriber", ALIVE.format(vehicle=party.name, service="*")
            yield "egress", "liveliness_token", ALIVE.format(vehicle=party.name, service="integrity")
    if party.kind == "map_update":
        yield "ingress", "liveliness_token", ALIVE.format(vehicle=FLEET, service="map_update")
        for message in ("liveliness_query", "declare_liveliness_subscriber"):
            yield "egress", message, every
    if party.kind in watched:
        for message in ("liveliness_query", "declare_liveliness_subscriber"):
            yield "ingress", message, every
        yield "egress", "liveliness_token", every
    if party.kind == "judge":
        yield "ingress", "liveliness_token", ALIVE.format(vehicle="*", service="integrity")


def cloud_access_control(parties: Sequence[Party], routers: Sequence[str]) -> dict[str, Any]:
    """Return `access_control` of the cloud's routers; `routers`: common names of all, which trust one another."""
    for names in ([*routers, *(p.certificate for p in parties)], [p.name for p in parties]):
        for name, times in Counter(names).items():
            if times > 1:
                raise ValueError(f"{name}: stands for more than one party")
    kinds = {party.kind for party in parties}
    subjects = {"routers": ({"cert_common_names": list(routers)}, [_everything()])}
    for party in parties:
        matches, rules = {"cert_common_names": [party.certificate]}, _rules(allowed_messages(party, kinds))
        # The kind as prefix keeps any common name from colliding with the id of another subject or rule.
        subjects[f"{party.kind} {party.certificate}"] = matches, rules
    return _access_control(subjects)


def vehicle_access_control(vehicle: str, kinds: Iterable[Kind]) -> dict[str, Any]:
    """Return `access_control` of a vehicle's router: everything inside, the cloud's rules mirrored on the uplink."""
    opposite: dict[Flow, Flow] = {"ingress": "egress", "egress": "ingress"}
    party = Party(kind="vehicle", name=vehicle)
    mirror = [replace(item, flow=opposite[item.flow]) for item in allowed_messages(party, kinds)]
    inside = {"link_protocols": list(INSIDE)}, [_everything()]
    return _access_control({"inside": inside, "cloud": ({"link_protocols": list(OUTSIDE)}, _rules(mirror))})


def _access_control(subjects: dict[str, tuple[dict[str, list[str]], list[Rule]]]) -> dict[str, Any]:
    """Return the access control of subjects by id, each with what it matches and its own rules."""
    rules = {
        name: {f"{name} {k}": rule for k, rule in enumerate(of, 1)} for name, (_, of) in subjects.items()
    }
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {"id": number, "permission": "allow", **rule}
            for numbered in rules.values()
            for number, rule in numbered.items()
        ],
        "subjects": [{"id": name, **matches} for name, (matches, _) in subjects.items()],
        "policies": [{"rules": list(rules[name]), "subjects": [name]} for name in subjects],
    }


def _everything() -> Rule:
    return {"flows": ["ingress", "egress"], "messages": list(MESSAGES), "key_exprs": ["**"]}


def _rules(items: Sequence[AllowedMessage]) -> list[Rule]:
    """Return the smallest set of equivalent rules: message types with the same keys share one."""
    keys: dict[tuple[Flow, str], list[str]] = {}
    for item in items:
        keys.setdefault((item.flow, item.message), []).append(item.key)
    messages: dict[tuple[Flow, tuple[str, ...]], list[str]] = {}
    for (flow, message), of_message in keys.items():
        messages.setdefault((flow, tuple(of_message)), []).append(message)
    return [
        {"flows": [flow], "messages": of_keys, "key_exprs": list(key_exprs)}
        for (flow, key_exprs), of_keys in messages.items()
    ]
