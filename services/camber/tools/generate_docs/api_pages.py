"""Pages of the Python API: signatures and docstrings of the packages that a user may import, read from the sources.

The sources are parsed, not imported. Messages stand on the page `data-flow.md` with their fields and units, so that the
page of `camber.schemas` names them only.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path

import griffe

SOURCE_ROOTS = (Path(__file__).parents[4] / "schemas", Path(__file__).parents[3])
PACKAGES = (
    "api",
    "schemas",
    "geodesy",
    "formats",
    "road_map",
    "gnss",
    "map_server",
    "localizer",
    "antenna_height",
    "integrity",
    "map_update",
    "sensors",
)
"""The library, and packages of `camber` that hold values and computations: what wires them to
the bus is no interface for a program."""
WIRING = frozenset({"service", "settings", "__main__", "warm_up"})
"""Modules of a service that are not pure (CONTRIBUTING, "Layout")."""
_WIDTH = 88  # chosen: characters of a signature that a page shows beside the navigation without scrolling
_INDEX = """\
# Python API

`camber.api` holds what `import camber` offers; it is [stable](../library.md). The others may change with any version.
They are pure: values and time in, results out. Inputs and outputs of services are [messages](../data-flow.md); frames,
heights, times and units are those of [conventions](../conventions.md).

| package | contents |
|---|---|
"""


def api_pages() -> dict[str, str]:
    """Return the text of each page by its path below the pages of the site, `api/index.md` first."""
    roots = [griffe.GriffeLoader(search_paths=[root]).load("camber") for root in SOURCE_ROOTS]
    members = {m.name: m for root in roots if isinstance(root, griffe.Object) for m in _members(root)}
    packages = [package for name in PACKAGES for package in _packages(members[name])]
    rows = [f"| [`{package.path}`]({_file_name(package)}) | {_first_line(package)} |" for package in packages]
    pages = {"api/index.md": _INDEX + "\n".join(rows) + "\n"}
    return pages | {f"api/{_file_name(package)}": _page(package) for package in packages}


def _packages(package: griffe.Object) -> Iterator[griffe.Object]:
    yield package
    for member in _members(package):
        if member.is_module and member.is_init_module:
            yield from _packages(member)


def _file_name(package: griffe.Object) -> str:
    return f"{package.path.removeprefix('camber.')}.md"


def _members(parent: griffe.Object) -> list[griffe.Object]:
    """Return public members in the order of the file, without what it imports; submodules by name."""
    members = [
        member
        for name, member in parent.members.items()
        if isinstance(member, griffe.Object) and not name.startswith("_")
    ]
    return sorted(members, key=lambda member: (member.is_module, member.name if member.is_module else ""))


def _page(package: griffe.Object) -> str:
    parts = [f"# {package.path}", _text(package), *_contents(package, "##")]
    for module in _members(package):
        if module.is_module and not module.is_init_module and module.name not in WIRING:
            parts += [f"## {module.name}", f"`{module.path}`", _text(module), *_contents(module, "###")]
    return "\n\n".join(part for part in parts if part) + "\n"


def _contents(module: griffe.Object, heading: str) -> Iterator[str]:
    """Yield constants with a docstring, then classes and functions."""
    for member in _members(module):
        if isinstance(member, griffe.Attribute) and member.docstring:
            yield f"{heading} {member.name}"
            yield _code(f"{member.name} = {member.value}")
            yield _text(member)
    for member in _members(module):
        if isinstance(member, griffe.Class):
            yield f"{heading} {member.name}"
            yield from _class(member)
        elif isinstance(member, griffe.Function):
            yield f"{heading} {member.name}"
            yield from _function(member)


def _class(cls: griffe.Class) -> Iterator[str]:
    bases = [str(base) for base in cls.bases]
    if cls.path.startswith("camber.schemas.") and {"Message", "Model"} & set(bases):
        yield f"{_first_line(cls)} [Fields and units](../data-flow.md#{cls.name.lower()})"
        return
    init = cls.members.get("__init__")
    parameters = list(init.parameters)[1:] if isinstance(init, griffe.Function) and init.lineno else []
    yield _code(f"class {_signature(cls.name, parameters)}" if parameters else f"class {cls.name}")
    yield _text(cls)
    members = _members(cls)
    fields = [member for member in members if isinstance(member, griffe.Attribute)]
    yield _fields([field for field in fields if field.annotation and "property" not in field.labels])
    for member in members:
        if isinstance(member, griffe.Function):
            yield from _function(member, owner=cls.name)
        elif isinstance(member, griffe.Attribute) and "property" in member.labels:
            yield _code(f"{cls.name}.{member.name} -> {member.annotation}")
            yield _text(member)


def _function(function: griffe.Function, owner: str | None = None) -> Iterator[str]:
    parameters = list(function.parameters)
    name = function.name
    if owner is not None:
        name = f"{owner}.{name}"
        parameters = parameters if "staticmethod" in function.labels else parameters[1:]
    yield _code(_signature(name, parameters, returns=function.returns))
    yield _text(function)


def _signature(
    name: str, parameters: Iterable[griffe.Parameter], returns: str | griffe.Expr | None = None
) -> str:
    """Return the signature on one line, or with a line for each parameter where it would be too long."""
    shown, has_star = [], False
    for parameter in parameters:
        kind = parameter.kind
        if kind is griffe.ParameterKind.keyword_only and not has_star:
            shown.append("*")
        has_star |= kind in (griffe.ParameterKind.keyword_only, griffe.ParameterKind.var_positional)
        shown.append(_parameter(parameter))
    end = "" if returns is None else f" -> {returns}"
    line = f"{name}({', '.join(shown)}){end}"
    if len(line) <= _WIDTH:
        return line
    return "\n".join([f"{name}(", *(f"    {text}," for text in shown), f"){end}"])


def _parameter(parameter: griffe.Parameter) -> str:
    annotation = "" if parameter.annotation is None else f": {parameter.annotation}"
    if parameter.kind is griffe.ParameterKind.var_positional:
        return f"*{parameter.name}{annotation}"
    if parameter.kind is griffe.ParameterKind.var_keyword:
        return f"**{parameter.name}{annotation}"
    return f"{parameter.name}{annotation}" + ("" if parameter.default is None else f" = {parameter.default}")


def _fields(fields: list[griffe.Attribute]) -> str:
    """Return the table of fields, without columns in which nothing stands."""
    if not fields:
        return ""
    rows = [["field", "type", "default", "meaning"]]
    for field in fields:
        default, description = _default(None if field.value is None else str(field.value))
        meaning = " ".join(field.docstring.value.split()) if field.docstring else description
        rows.append([_span(field.name), _span(str(field.annotation)), _span(default), escaped(meaning)])
    columns = [column for column in zip(*rows, strict=True) if any(column[1:])]
    header, *lines = [f"| {' | '.join(row)} |" for row in zip(*columns, strict=True)]
    return "\n".join([header, "|" + "---|" * len(columns), *lines])


def _span(text: str) -> str:
    return f"`{text}`" if text else ""


def _default(value: str | None) -> tuple[str, str]:
    """Return the default of a field and its description: both stand in the call of `Field` or `field`, if any."""
    if value is None:
        return "", ""
    call = ast.parse(value, mode="eval").body
    if not (
        isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in ("Field", "field")
    ):
        return value, ""
    named = {keyword.arg: keyword.value for keyword in call.keywords}
    description = named.get("description")
    default = call.args[0] if call.args else named.get("default")
    factory = named.get("default_factory")
    text = ast.unparse(default) if default is not None else ""
    if factory is not None:
        text = ast.unparse(factory.body) if isinstance(factory, ast.Lambda) else f"{ast.unparse(factory)}()"
    return text, str(ast.literal_eval(description)) if description is not None else ""


def _first_line(item: griffe.Object) -> str:
    return escaped(item.docstring.value.split("\n\n")[0].replace("\n", " ")) if item.docstring else ""


def _text(item: griffe.Object) -> str:
    return escaped(item.docstring.value) if item.docstring else ""


def _code(text: str) -> str:
    return f"```python\n{text}\n```"


def escaped(text: str) -> str:
    """Return Markdown in which no `<` begins a tag; code spans and indented code stay."""
    lines = []
    for line in text.split("\n"):
        parts = line.split("`")
        if not line.startswith("    "):
            parts[::2] = [part.replace("<", "&lt;") for part in parts[::2]]
        lines.append("`".join(parts))
    return "\n".join(lines)
