"""The access rules as a table for people: made from the rules themselves."""

from __future__ import annotations

from typing import get_args

from camber.schemas.channels import CHANNELS
from camber.tools.security.access_rules import Allowed, Kind, Party, allowed

_KINDS: tuple[Kind, ...] = get_args(Kind)
_WORDS = {
    ("ingress", "put"): "publishes",
    ("ingress", "declare_subscriber"): "hears",
    ("ingress", "query"): "asks",
    ("ingress", "declare_queryable"): "answers",
}
_HEADINGS = {
    "vehicle": "vehicle `V`",
    "map_update": "`map_update`",
    "consumer": "consumer",
    "judge": "judge in the cloud",
    "operator": "operator",
}


def table_text() -> str:
    """One row for each channel that is open to somebody, one column for each kind of certificate."""
    rules = {kind: allowed(Party(kind, "V" if kind == "vehicle" else kind), _KINDS) for kind in _KINDS}
    lines = [
        "| channel | key | " + " | ".join(_HEADINGS[kind] for kind in _KINDS) + " |",
        "|---|---" + "|---" * len(_KINDS) + "|",
    ]
    for channel in CHANNELS:
        key = channel.key.replace("{vehicle}", "V")
        cells = [_cell(rules[kind], channel.key) for kind in _KINDS]
        if any(cells):
            lines.append(f"| `{channel.name}` | `{key}` | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _cell(rules: list[Allowed], key: str) -> str:
    """What this kind does on a key of the table; with whose key, where it is not just its own vehicle's."""
    said = []
    for item in rules:
        word = _WORDS.get((item.flow, item.message))
        if word is not None and _is_of(item.key, key):
            said.append(word)
    return ", ".join(dict.fromkeys(said))


def _is_of(key: str, pattern: str) -> bool:
    parts, wanted = key.split("/"), pattern.split("/")
    return len(parts) == len(wanted) and all(
        part == want or want.startswith("{") for part, want in zip(parts, wanted, strict=True)
    )
