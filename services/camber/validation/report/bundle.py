"""One self-contained page of modules, styles and data: opened from a disk it fetches nothing."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

STATIC = Path(str(files("camber.live"))) / "static"
HERE = Path(str(files("camber.validation.report"))) / "static"
_IMPORT = re.compile(r'^import (?:(.+) from )?"([^"]+)";\n', re.MULTILINE)
_EXPORTED = re.compile(r"^export (?=(?:async )?(?:class|function|const) (\w+))", re.MULTILINE)
_DEFAULT = re.compile(r"^export \{ (\w+) as default \};\n", re.MULTILINE)
_STYLES = (STATIC / "vendor/uplot/uPlot.min.css", STATIC / "live.css", HERE / "report.css")


def page(title: str, content: str, *, script: str, facts: Any, rows: str = "") -> str:
    """The page as text. `title` and `content` are HTML, `script` is a module here, `facts` becomes JSON."""
    parts = {
        "title": title,
        "style": "\n".join(path.read_text("utf-8") for path in _STYLES),
        "content": content,
        "facts": embedded_json(facts),
        "rows": rows,
        "script": bundled(HERE / script),
    }
    return filled((HERE / "shell.html").read_text("utf-8"), parts)


def filled(template: str, parts: Mapping[str, str]) -> str:
    """A template with its places filled, in one pass, so that untrusted text cannot contain a place."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template)


def embedded_json(data: Any) -> str:
    """JSON that cannot end the script element around it."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def bundled(entry: Path) -> str:
    """A module and all that it imports as one script: a browser does not load modules from a disk."""
    bodies: dict[Path, str] = {}
    _add_module(entry.resolve(), bodies)
    licence = (STATIC / "vendor/uplot/LICENSE").read_text("utf-8")
    text = "\n".join(('"use strict";', f"/* uPlot\n{licence}*/", *bodies.values()))
    return re.sub("</script", r"<\\/script", text, flags=re.IGNORECASE)


def _add_module(path: Path, bodies: dict[Path, str]) -> None:
    """Append a module as a function that is called once, after the modules it imports."""
    if path in bodies:
        return
    text = path.read_text("utf-8")
    for _, address in _IMPORT.findall(text):
        _add_module((path.parent / address).resolve(), bodies)

    def imported(match: re.Match[str]) -> str:
        names, module = match[1], _name(list(bodies).index((path.parent / match[2]).resolve()))
        if names is None:
            return ""
        return (
            f"const {names} = {module};\n"
            if names.startswith("{")
            else f"const {names} = {module}.default;\n"
        )

    # A library has one export, at its end; what else looks like one stands in a comment.
    exported = [f"default: {name}" for name in _DEFAULT.findall(text)] or _EXPORTED.findall(text)
    body = _DEFAULT.sub("", _EXPORTED.sub("", _IMPORT.sub(imported, text)))
    bodies[path] = (
        f"const {_name(len(bodies))} = (() => {{\n{body}\nreturn {{ {', '.join(exported)} }};\n}})();"
    )


def _name(number: int) -> str:
    return f"module{number}"
