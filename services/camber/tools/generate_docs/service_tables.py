"""Tables of services: every setting with its default, range and meaning, and every issue of `issues.toml`."""

from __future__ import annotations

import functools
import importlib
import tomllib
from importlib.resources import files
from typing import Any

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from camber.runtime.settings import ServiceSettings

_HEAD = ("| code | means | meanwhile | check and do |", "|---|---|---|---|")
_BOUNDS = {"gt": "above", "ge": "from", "lt": "below", "le": "to"}


def parameter_table(service: str) -> str:
    """Return the Markdown table of all settings that a service has beyond those of every service."""
    settings: type[ServiceSettings] = importlib.import_module(f"camber.{service}.service").SERVICE.SETTINGS
    specific = [name for name in settings.model_fields if name not in ServiceSettings.model_fields]
    rows = [row for name in specific for row in _rows(name, settings)]
    return "\n".join(["| setting | default | range | meaning |", "|---|---|---|---|", *rows])


def _rows(name: str, settings: type[BaseModel], prefix: str = "") -> list[str]:
    """One row, or a row for each setting of a nested table."""
    info = settings.model_fields[name]
    table: Any = info.annotation
    if info.default_factory is not None and issubclass(table, BaseModel):
        return [row for nested in table.model_fields for row in _rows(nested, table, f"{prefix}{name}.")]
    default, bounds = _default(info.get_default()), _bounds(info.metadata)
    return [f"| `{prefix}{name}` | {default} | {bounds} | {info.description} |"]


def _default(value: Any) -> str:
    if value is PydanticUndefined:
        return "must be set"
    if value is None:
        return "unset"
    if value == "":
        return "empty"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def _bounds(metadata: list[Any]) -> str:
    bounds = ((text, getattr(item, name, None)) for item in metadata for name, text in _BOUNDS.items())
    return " ".join(f"{text} {bound:g}" for text, bound in bounds if bound is not None).replace("-", "−")


@functools.cache
def issues_by_service() -> dict[str, dict[str, dict[str, str]]]:
    """Return service (`any_service`: every one) → issue code → `means`, `meanwhile` and `remedy`."""
    return tomllib.loads(files("camber.runtime.health").joinpath("issues.toml").read_text("utf-8"))


def runbook_rows(service: str) -> str:
    """Return the Markdown table of a service's issues."""
    rows = []
    for code, row in issues_by_service()[service].items():
        name = f"`{code}`" if code.isidentifier() else code
        meanwhile = f" {row['meanwhile']}" if row["meanwhile"] else ""
        rows.append(f"| {name} | {row['means']} |{meanwhile} | {row['remedy']} |")
    return "\n".join([*_HEAD, *rows])
