"""The access rules as a Markdown table, derived from the rules themselves."""

from __future__ import annotations

from typing import get_args

from camber.schemas.channels import CHANNELS
from camber.tools.security.access_rules import AllowedMessage, Kind, Party, allowed_messages

_KINDS: tuple[Kind, ...] = get_args(Kind)
_ACTIONS = {
    ("ingress", "put"): "publishes",
    ("ingress", "declare_subscriber"): "subscribes",
    ("ingress", "query"): "queries",
    ("ingress", "declare_queryable"): "replies",
}
_HEADINGS = {
    "vehicle": "vehicle `V`",
    "map_update": "`map_update`",
    "consumer": "consumer",
    "judge": "judge in the cloud",
    "operator": "operator",
}


def table_text() -> str:
    """Return one row for each channel open to any kind of certificate, one column for each kind."""
    rules = {
        kind: allowed_messages(Party(kind=kind, name="V" if kind == "vehicle" else kind), _KINDS)
        for kind in _KINDS
    }
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


def _cell(rules: list[AllowedMessage], key: str) -> str:
    """Return what the rules allow on a key of the table."""
    actions = [
        _ACTIONS[item.flow, item.message]
        for item in rules
        if (item.flow, item.message) in _ACTIONS and _matches(item.key, key)
    ]
    return ", ".join(dict.fromkeys(actions))


def _matches(key: str, pattern: str) -> bool:
    parts, wanted = key.split("/"), pattern.split("/")
    return len(parts) == len(wanted) and all(
        part == want or want.startswith("{") for part, want in zip(parts, wanted, strict=True)
    )
