"""Who may say what: Zenoh's access control, made from the table of channels and a list of names.

What nobody is allowed is denied. A party is a certificate's common name and what it stands for. A channel is open
between two of them where the table has one among its producers and the other among its consumers; so within a vehicle
nothing is open to the outside, and no rule ever names two vehicles. Rules are those of the cloud's router; a vehicle's
own router has their mirror for its one link, so that neither has to trust the file of the other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

from camber.runtime.access_probe import echo_key
from camber.runtime.session import OUTSIDE
from camber.schemas.channels import CHANNELS, SENSORS, VEHICLE_SERVICES, Channel

Kind = Literal["vehicle", "map_update", "consumer", "judge", "operator"]
Flow = Literal["ingress", "egress"]
FLEET = "fleet"
"""The vehicle's name in keys of services of the cloud."""
INSIDE = ("tcp", "unixsock-stream")
MESSAGES = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)
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


@dataclass(frozen=True, slots=True)
class Party:
    """A certificate and what it stands for; `name` is the vehicle's, or the common name itself."""

    kind: Kind
    name: str
    common_name: str = ""

    @property
    def certificate(self) -> str:
        """The common name that stands in the certificate."""
        return self.common_name or self.name


@dataclass(frozen=True, slots=True)
class Allowed:
    """One message that may pass the cloud's router, on its way in from a party or out to it."""

    flow: Flow
    message: str
    key: str


def open_channels(kinds: Iterable[Kind]) -> Iterator[tuple[Channel, Kind, Kind]]:
    """Each channel with a kind that speaks (publishes, asks) and one that hears (subscribes, answers)."""
    present = [kind for kind in _ROLES if kind in set(kinds)]
    for channel, speaker, hearer in product(CHANNELS, present, present):
        if channel.delivery != "barrier" and _speaks(channel, speaker) and _hears(channel, hearer, speaker):
            yield channel, speaker, hearer


def _speaks(channel: Channel, kind: Kind) -> bool:
    # An upload is a vehicle's word: by hand it is sent from the vehicle, with its certificate.
    if channel.delivery == "upload" and "tools" in channel.producers:
        return kind == "vehicle"
    # Its health check asks map_update with the certificate of map_update.
    return bool(_ROLES[kind] & set(channel.producers)) or (kind == "map_update" and _of_itself(channel))


def _hears(channel: Channel, kind: Kind, speaker: Kind) -> bool:
    if speaker == kind:
        return kind == "map_update" and _of_itself(channel)
    if speaker == "map_update" and _of_itself(channel):
        return False
    return bool(_ROLES[kind] & set(channel.consumers))


def _of_itself(channel: Channel) -> bool:
    return "{service}" in channel.key


def allowed(party: Party, kinds: Iterable[Kind]) -> list[Allowed]:
    """All that the cloud's router lets pass from and to one party, where parties of `kinds` exist."""
    kinds = set(kinds) | {party.kind}
    found: dict[Allowed, None] = {}

    def add(flow: Flow, message: str, *keys: str) -> None:
        found.update(dict.fromkeys(Allowed(flow, message, key) for key in keys))

    for channel, speaker, hearer in open_channels(kinds):
        keys, wide = _keys(channel, party, speaker, hearer)
        asked = channel.reply is not None
        if speaker == party.kind:
            add("ingress", "query" if asked else "put", *keys)
            # Who hears may do so of all vehicles at once, and declares just that.
            add("egress", "declare_queryable" if asked else "declare_subscriber", *keys, *wide)
            if asked:
                add("egress", "reply", *keys)
        if hearer == party.kind:
            add("ingress", "declare_queryable" if asked else "declare_subscriber", *keys)
            add("egress", "query" if asked else "put", *keys)
            if asked:
                add("ingress", "reply", *keys)
    for flow, message, key in _alive(party, kinds):
        add(flow, message, key)
    for message in ("put", "declare_subscriber"):
        add("ingress", message, _echo(party))
        add("egress", message, _echo(party))
    return list(found)


def _echo(party: Party) -> str:
    """Where this party hears itself: that of the name in which it speaks, a judge in any."""
    return echo_key({"judge": "*", "map_update": FLEET}.get(party.kind, party.name))


def _keys(channel: Channel, party: Party, speaker: Kind, hearer: Kind) -> tuple[list[str], list[str]]:
    """The party's own keys of a channel, and those with a `*` under which others may declare them."""
    # Services of the cloud go by the name of the fleet; a judge there by that of each vehicle.
    in_fleet = hearer == "map_update" and "{service}" in channel.key
    service = _SERVICE.get(hearer, "*")
    wide = channel.key_for(FLEET if in_fleet else "*").replace("{service}", service)
    if party.kind != "vehicle" or in_fleet:
        return [wide], []
    own = channel.key_for(party.name)
    if "{service}" not in own:
        return [own], [wide]
    return [own.replace("{service}", name) for name in _WITHIN], [wide]


def _alive(party: Party, kinds: set[Kind]) -> Iterator[tuple[Flow, str, str]]:
    """Who is there is known to those that ask for it: a judge in the cloud, and operators."""
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
    """`access_control` of the cloud's routers; `routers` are the common names of all of them, who trust one another."""
    for names in ([*routers, *(p.certificate for p in parties)], [p.name for p in parties]):
        for name, times in Counter(names).items():
            if times > 1:
                raise ValueError(f"{name}: stands for more than one party")
    kinds = {party.kind for party in parties}
    control = _Control()
    control.subject("routers", {"cert_common_names": list(routers)}, [_everything()])
    for party in parties:
        subject = {"cert_common_names": [party.certificate]}
        # With the kind before it no common name can be the id of another's subject or rule.
        control.subject(f"{party.kind} {party.certificate}", subject, _rules(allowed(party, kinds)))
    return control.made()


def vehicle_access_control(vehicle: str, kinds: Iterable[Kind]) -> dict[str, Any]:
    """`access_control` of a vehicle's own router: all within, and over the link what the cloud's router lets pass."""
    turned: dict[Flow, Flow] = {"ingress": "egress", "egress": "ingress"}
    mirror = [
        Allowed(turned[item.flow], item.message, item.key)
        for item in allowed(Party("vehicle", vehicle), kinds)
    ]
    control = _Control()
    control.subject("inside", {"link_protocols": list(INSIDE)}, [_everything()])
    control.subject("cloud", {"link_protocols": list(OUTSIDE)}, _rules(mirror))
    return control.made()


class _Control:
    """Collects rules, subjects and policies under names that refer to one another."""

    def __init__(self) -> None:
        self._rules: list[dict[str, Any]] = []
        self._subjects: list[dict[str, Any]] = []
        self._policies: list[dict[str, Any]] = []

    def subject(self, name: str, matches: dict[str, Any], rules: list[dict[str, Any]]) -> None:
        ids = [f"{name} {number}" for number in range(1, len(rules) + 1)]
        self._rules += [{"id": i, "permission": "allow", **rule} for i, rule in zip(ids, rules, strict=True)]
        self._subjects.append({"id": name, **matches})
        self._policies.append({"rules": ids, "subjects": [name]})

    def made(self) -> dict[str, Any]:
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": self._rules,
            "subjects": self._subjects,
            "policies": self._policies,
        }


def _everything() -> dict[str, Any]:
    return {"flows": ["ingress", "egress"], "messages": list(MESSAGES), "key_exprs": ["**"]}


def _rules(items: Sequence[Allowed]) -> list[dict[str, Any]]:
    """As few rules as say the same: messages with the same keys share one."""
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
